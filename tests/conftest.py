"""Robots and runs that several tests look at; one BLAS thread, since all matrices are small."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import functools

import numpy as np
import pytest

import eladapt as ea

# Every kind of joint and parameter: planar, 6 and 7 joints, continuous joints, rotors.
ROBOTS = (
    "two_link", "double_pendulum", "panda", "ur5", "ur10", "xarm7", "kinova", "z1", "talos_left_arm",
)  # fmt: skip


@functools.cache
def load(name: str) -> ea.Robot:
    return ea.Robot.load(name)


@functools.cache
def regressors(name: str, sharing: str = "shared", friction: bool = False) -> ea.Regressors:
    return ea.Regressors(load(name), sharing=sharing, friction=friction)


@pytest.fixture(params=ROBOTS)
def robot(request) -> ea.Robot:
    return load(request.param)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)
