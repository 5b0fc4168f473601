"""What rows tell of parameters, and what they do not."""

import numpy as np

from eladapt.identification.fitting import fit
from eladapt.identification.rows import Rows

N = 400


def rows(columns, theta, noise=0.0):
    """Of one joint, from columns (N, l)."""
    y = columns @ theta + noise * np.random.default_rng(1).standard_normal(N)
    return Rows(np.arange(N) * 0.05, y[:, None], columns[:, None, :], np.ones((N, 1), bool))


def test_what_explains_much_of_the_torque_is_told_though_its_column_is_small():
    """Judged by the torque, not the noise, it would stay out, and its own torque would pass for noise."""
    rng = np.random.default_rng(0)
    small = 0.2 * rng.choice([-1.0, 1.0], N)  # its norm is 4: below 1 / DOUBT, what the first noise would ask
    true = np.array([5.0, 30.0])
    found = fit(rows(np.column_stack([rng.standard_normal(N), small]), true, noise=0.1), np.zeros(2))
    assert len(found.untold) == 0
    # 0.1 N m of noise over a column of norm 4 is 0.025 of theta's second entry: five of these
    np.testing.assert_allclose(found.theta, true, atol=0.13)


def test_what_no_row_sees_keeps_its_start():
    """A column of zeros tells nothing."""
    rng = np.random.default_rng(0)
    found = fit(
        rows(np.column_stack([rng.standard_normal(N), np.zeros(N)]), np.array([5.0, 0.0])),
        np.array([0.0, 7.0]),
    )
    assert len(found.untold) == 1
    np.testing.assert_allclose(found.theta, [5.0, 7.0], atol=1e-6)  # no noise: rounding only


def test_what_drowns_in_noise_keeps_its_start():
    """A column whose parameter the noise hides is not told, whatever the first round makes of it."""
    rng = np.random.default_rng(0)
    columns = np.column_stack([rng.standard_normal(N), 1e-3 * rng.standard_normal(N)])
    found = fit(rows(columns, np.array([5.0, 7.0]), noise=1.0), np.array([0.0, 7.0]))
    assert len(found.untold) == 1
    np.testing.assert_allclose(found.theta[1], 7.0, atol=1e-2)  # the columns are not quite at right angles
