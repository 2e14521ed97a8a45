"""What an integrator says about itself: one record, made by the file of its name."""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from particlerb.maths.vec3 import Floats

Step: TypeAlias = Callable[..., None]  # (moving, first, end, open_kick, dt): see `Method.step`


class Method(NamedTuple):
    """An integrator."""

    summary: str
    """One line for `particlerb methods`."""
    order: int
    """0 for a closed form, which has no step."""
    accepts: frozenset[str]
    """What it takes into account: see forces/kinds.py, for `exact` stepping/closed_forms.py."""
    cost: float
    """Time for a step, or a frame, of one body without its neighbours, roughly [ns]."""
    name: str = ""
    """That of its file, which the list of methods gives it."""
    evaluations: int = 0
    """Evaluations of the forces in a step."""
    takes_gradients: bool = False
    """Whether it asks how fast forces change along a motion: `Kick.change`."""
    is_adaptive: bool = False
    """Whether it chooses its steps by a tolerance."""
    keeps_rods: bool = False
    """Whether L of a rod stays across its axis to rounding, and not to the error of the steps."""
    keeps_angular_momentum: bool = True
    """Whether L changes by torques alone, as it should."""
    stability_limit: float = math.inf
    """Largest hω of an oscillator that stays bounded; of methods with a fixed step."""
    max_turn: float = math.inf
    """Turn of a body in a step above which a warning is due [rad]."""
    closing_kick: float = 0.0
    """Share of dt of the kick with which a step ends; 0 where it ends with none."""
    step: Step | None = None
    """Stages of a step: `step(moving, first, end, open_kick, dt)` advances the blocks `first` to
    `end`, `end` excluded, of `stages.MovingBodies` by dt [s]. The closing kick is left open: the
    next step makes it, open_kick [s] long, together with its own first one."""
    coupled_step: Step | None = None
    """The same for bodies that act on each other, where that takes other stages."""
    show: Callable[..., None] | None = None
    """Of methods that take contact and end a step with no kick: what evaluates contacts at a frame,
    `show(moving, first, end, open_kick, instant)`."""
    takes_slopes: bool = False
    """Whether tangential springs of contacts take several slopes in a step."""
    contact_limit: Callable[[float], float] | None = None
    """Largest hω of bodies that rest on contacts with a damping ratio ζ."""
    holds_joints: bool = False
    """Whether it is for bodies that joints hold, and for no others."""
    takes_impulses: bool = False
    """Whether it is for contacts without stiffness, and for no others."""
    has_dashpot_flows: bool = False
    """Whether dashpots between bodies are exact flows among the stages, and not loads."""
    weights: tuple[float, ...] = (1.0,)
    """Lengths of the stages of a composition, over the step."""
    rotor_constants: Callable[[Floats], Floats] | None = None
    """Constants of asymmetric bodies, from their inverse moments (3, n): rows ROTOR of a block.
    Where there are any, asymmetric bodies have blocks of their own."""
    asymmetric_cost: Callable[[float], float] | None = None
    """Cost of an asymmetric body over that of others, from its turn in a step [rad]."""
