"""A real Panda's log (Gaz and others, 2019): what is held out is predicted, by bodies that can be."""

from pathlib import Path

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.regressors.standard import pseudo_inertia

LOG = Path(__file__).resolve().parents[3] / "shared" / "logs" / "panda_exciting.npz"


@pytest.mark.skipif(not LOG.is_file(), reason="the log of a real Panda is not there")
def test_a_real_panda():
    """The torques of the last 30 %, below 10 Hz: the URDF is 18 % off, plain least squares with differenced
    accelerations 1.55 %; asked are 1.45 %, and 1.50 % with all bodies physical."""
    found = ea.identify(load("panda"), ea.Log.read(LOG), progress=False)
    assert found.errors["URDF"].raw[-1] > 0.15
    assert found.errors["identified"].raw[-1] < 0.0145
    assert found.errors["physical"].raw[-1] < 0.0150
    for k in range(0, 70, 10):
        assert np.linalg.eigvalsh(pseudo_inertia(found.parameters[k : k + 10]))[0] > 0
    assert found.untold == ()
    rng = np.random.default_rng(0)
    for _ in range(100):
        assert np.linalg.eigvalsh(found.robot.mass_matrix(found.robot.random_configuration(rng)))[0] > 0
