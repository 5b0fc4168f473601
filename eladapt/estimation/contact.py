"""What acts on the arm from outside: how much, and whether it is a load that it carries or something it
touches.

The torque of the arm's own model, W(q, v, a) theta, with the mean acceleration of a step, less the torque
that acted, is what came from elsewhere; summed up over many steps only the momentum's change is left of the
acceleration. What comes to an arm that rests at its goal is no error of the model, which explained the rest:
it is a load or a contact. A load pulls towards the ground, from somewhere near the tool, and nothing else:
what no mass there explains is a contact. An arm learns nothing of a contact, or it would take a push for its
own weight and friction. A joint that sticks bears any torque up to its friction, from outside or its own; as
far as that is known, what comes and goes there tells nothing.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, kernel
from eladapt.errors import require_gain, require_number
from eladapt.estimation.payload import payload_regressor
from eladapt.regressors.regressors import Regressors
from eladapt.robot.reading import frame_index, last_body

# Chosen, not derived, as the defaults of the detector are. What they do to pushes and loads is measured by
# benchmarks/contact.py: of 20 N or 2 kg at a panda that rests, 91 to 97 % are told as what they are.
REACH = 0.1  # [m] from the tool's frame, within which a load's centre of mass is likely
DEVIATIONS = 8.0  # of its scatter at rest, from which on it counts as something new
MISSED = 2.0  # of the scatter, which a load may leave as well
LEAST_JOINTS = 5  # that can tell: four numbers of a load explain what four joints feel
GRACE = 0.02  # [s] for which an arm that rested may move before that counts
QUIET = 0.05  # [s] for which it has to be gone


class ContactState(NamedTuple):
    """What acts from outside, and what is thought of it."""

    external: np.ndarray  # (nv,) [N m] on the arm
    usual: np.ndarray  # (nv,) [N m] while it rested
    scatter: np.ndarray  # (nv,) [N^2 m^2] mean square about that
    rested: float  # [s] for how long the arm has been at its goal, at most `rest` and `GRACE`
    since: float  # [s] for how long something new has acted; -1: nothing has
    touching: bool  # whether that is a contact
    gone: float  # [s] for how long it has been gone

    @property
    def acting(self) -> bool:
        """Whether it touches something, or may: nothing is learned meanwhile."""
        return self.since >= 0.0


@kernel(VECTOR, VECTOR, SCALAR)
def averaged(mean: np.ndarray, now: np.ndarray, share: float) -> np.ndarray:
    """(nv,) ``share`` of the way from the mean to what is now."""
    found = np.empty(len(mean))
    for i in range(len(mean)):
        found[i] = mean[i] + share * (now[i] - mean[i])
    return found


@kernel(VECTOR, VECTOR, VECTOR, SCALAR)
def scattered(scatter: np.ndarray, external: np.ndarray, usual: np.ndarray, share: float) -> np.ndarray:
    """(nv,) the same for the mean square of what is off the usual."""
    found = np.empty(len(scatter))
    for i in range(len(scatter)):
        found[i] = scatter[i] + share * ((external[i] - usual[i]) ** 2 - scatter[i])
    return found


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, SCALAR)
def within(
    external: np.ndarray, usual: np.ndarray, scatter: np.ndarray, friction: np.ndarray, effort: np.ndarray,
    least: float,
) -> bool:  # fmt: skip
    """Whether nothing acts that is new: off the usual by no more than ``least`` of the effort, or than the
    scatter may be, beyond what friction bears, pulling one way and then the other."""
    for i in range(len(usual)):
        noise = max(least * effort[i], DEVIATIONS * math.sqrt(scatter[i]))
        if abs(external[i] - usual[i]) > noise + 2 * friction[i]:
            return False
    return True


@dataclass(frozen=True, eq=False)
class ContactDetector:
    """Tells contacts from loads; see the module.

    effort (nv,) [N m]: the limits; ``least`` of them counts as nothing. memory [s]: over which external
    torque is averaged. rest [s]: for how long an arm has to rest before it notices. patience [s]: from the
    first sign to the verdict. longest [s]: of a contact; what lasts longer is learned. misfit: the part of
    what came that no load explains, above which it is a contact. Arms of fewer than five joints cannot tell.
    """

    regressors: Regressors
    effort: np.ndarray
    least: float = 0.01
    memory: float = 0.01
    rest: float = 0.2
    patience: float = 0.04
    longest: float = 5.0
    misfit: float = 0.08

    def __post_init__(self) -> None:
        object.__setattr__(self, "effort", require_gain("effort", self.effort, self.regressors.robot.nv))
        for name in ("least", "memory", "rest", "patience", "longest", "misfit"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self) -> ContactState:
        """Nothing acts."""
        none = np.zeros(self.regressors.robot.nv)
        return ContactState(none, none, none, 0.0, -1.0, False, 0.0)

    def step(
        self, state: ContactState, outside: np.ndarray, q: np.ndarray, theta: np.ndarray, arrived: bool,
        still: bool, dt: float,
    ) -> ContactState:  # fmt: skip
        """A step of dt [s]: the external torque over it (nv,) [N m], the posture q (nq,), the estimate theta
        (l,), whether the arm is at a goal that rests, and whether it stands still there."""
        external = averaged(state.external, outside, -math.expm1(-dt / self.memory))
        friction = self._friction(theta)
        if state.since < 0:
            return self._resting(state, external, friction, arrived, still, dt)
        state = state._replace(external=external)
        since = state.since + dt
        if not state.touching:
            if since < self.patience:
                return state._replace(since=since)
            scatter = state.scatter + friction**2
            touching = self.unlike_a_load(external - state.usual, q, scatter, self._carried(theta))
            return state._replace(since=since if touching else -1.0, touching=touching, rested=0.0, gone=0.0)
        gone = state.gone + dt if self._nothing_new(state, external, friction) else 0.0
        over = gone > QUIET or since > self.longest
        return state._replace(since=-1.0 if over else since, touching=not over, gone=gone)

    def unlike_a_load(
        self, came: np.ndarray, q: np.ndarray, scatter: np.ndarray, carried: float = 0.0
    ) -> bool:
        """Whether no mass near the tool explains an external torque (nv,) [N m] in a posture q (nq,), given
        the mean square (nv,) of its errors; of what it carries [kg] the arm may have lost some."""
        if len(came) < LEAST_JOINTS:
            return False
        weighed = -self.regressors.gravity(q) @ self._load / self.effort[:, None]
        felt = came / self.effort
        pull = weighed[:, 0]
        mass = max(-carried, float(pull @ felt) / max(float(pull @ pull), np.finfo(float).tiny))
        near = weighed[:, 1:] * (REACH * abs(mass))
        unit = self.misfit * float(np.linalg.norm(felt)) / np.sqrt(len(felt))
        prior = np.concatenate([near, unit * np.eye(3)])  # the centre of mass is about that near
        left = felt - pull * mass
        columns = np.column_stack([np.concatenate([pull, np.zeros(3)]), prior])
        more = np.linalg.lstsq(columns, np.concatenate([left, np.zeros(3)]), rcond=None)[0]
        missed = left - pull * max(more[0], -carried - mass) - near @ more[1:]
        noise = float(np.linalg.norm(np.sqrt(scatter) / self.effort))
        return float(np.linalg.norm(missed)) > self.misfit * float(np.linalg.norm(felt)) + MISSED * noise

    def _resting(
        self, state: ContactState, external: np.ndarray, friction: np.ndarray, arrived: bool, still: bool,
        dt: float,
    ) -> ContactState:  # fmt: skip
        """The state while nothing new acts, or when it begins to."""
        _, usual, scatter, rested, since, touching, gone = state
        if not arrived:
            rested = 0.0
        elif rested > self.rest and not self._nothing_new(state, external, friction):
            since = 0.0
        elif not still:
            rested = rested - dt if rested > self.rest else 0.0
        else:
            share = -math.expm1(-dt / self.rest)
            if rested > 0:
                scatter = scattered(scatter, external, usual, share)
            usual = averaged(usual, external, share) if rested > 0 else external
            rested = min(rested + dt, self.rest + GRACE)
        return ContactState(external, usual, scatter, rested, since, touching, gone)

    def _nothing_new(self, state: ContactState, external: np.ndarray, friction: np.ndarray) -> bool:
        return within(external, state.usual, state.scatter, friction, self.effort, self.least)

    def _friction(self, theta: np.ndarray) -> np.ndarray:
        """(nv,) [N m] Coulomb friction by the estimate."""
        block = self.regressors.block("coulomb")
        found = np.abs(theta[block] / self.regressors.scale[block])
        return found if len(found) else np.zeros(len(self.effort))

    def _carried(self, theta: np.ndarray) -> float:
        """[kg] by how much the tool is heavier than in the URDF."""
        more = (theta - self.regressors.theta)[len(theta) - self.regressors.n_potential :]
        return max(0.0, float(np.linalg.lstsq(self._load, more, rcond=None)[0][0]))

    @functools.cached_property
    def _load(self) -> np.ndarray:
        """(n_potential, 4) what m and m c of a load at the tool, or at the last link where the tool does not
        move, add to theta_U."""
        model, tool = self.regressors.robot.model, self.regressors.robot.tool
        moves = model.frames[frame_index(model, tool)].parentJoint > 0
        effect = payload_regressor(self.regressors, tool if moves else last_body(model))
        return effect[len(self.regressors) - self.regressors.n_potential :, :4]
