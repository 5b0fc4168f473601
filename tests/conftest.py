"""Fixtures of all tests; one BLAS thread, since all matrices are small."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from shared import ROBOTS, load

import eladapt as ea

# The same cases every time; on a busy machine a case may take long. ``make nightly`` looks for new ones.
settings.register_profile(
    "usual", max_examples=400, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("nightly", settings.get_profile("usual"), max_examples=12_500, derandomize=False)
settings.load_profile("usual")


@pytest.fixture(params=ROBOTS)
def robot(request) -> ea.Robot:
    return load(request.param)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)
