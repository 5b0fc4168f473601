"""Fixtures of all tests; one BLAS thread, since all matrices are small."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from shared import ROBOTS, load

import eladapt as ea


@pytest.fixture(params=ROBOTS)
def robot(request) -> ea.Robot:
    return load(request.param)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)
