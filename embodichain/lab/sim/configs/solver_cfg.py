"""`SolverCfg`: the tool point of a control part, and settings of inverse kinematics: pure data."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from pydantic import Field

from embodichain.utils.configclass import configclass
from embodichain.utils.fields.no_effect import NoEffect

__all__ = ["SolverCfg"]


@configclass
class SolverCfg:
    """Tool point of a control part, and settings of its inverse kinematics.

    A `tcp`, or a site, becomes a separate link, `PART_tcp` (`tcp` for the whole robot), which terms
    use as the part's tool. Arms built like those of Universal Robots are solved in closed form,
    others by damped least squares.
    """

    class_type: Annotated[
        str, NoEffect("the solver follows from the arm: closed form, or damped least squares")
    ] = "SolverCfg"
    """No effect: the name of a solver of EmbodiChain."""
    urdf_path: Annotated[str | None, NoEffect("kinematics are those of the robot")] = None
    """No effect: kinematics are those of the robot."""
    joint_names: Annotated[list[str] | None, NoEffect("joints are those of the control part")] = (
        None
    )
    """No effect: joints are those of the control part."""
    end_link_name: str | None = None
    """The part's last link."""
    root_link_name: str | None = None
    """The part's first link; no effect, but it must exist."""
    tcp: Any = None
    """The tool point in the frame of `end_link_name`, or of `end_site_name`: a 4x4 matrix; None is
    that frame."""
    ik_nearest_weight: list[float] | None = None
    """Weights of the chain's joints, from root to tool, in the distance from the seed, by which
    solutions are ranked; None is 1."""
    pos_eps: Annotated[float, Field(gt=0)] = 1e-5
    """Metres: a solution is at most this far from the target."""
    rot_eps: Annotated[float, Field(gt=0)] = 1e-5
    """Likewise, in rad."""
    max_iterations: Annotated[int, Field(ge=1)] = 60
    """Of one search from one initial point."""
    num_samples: Annotated[int, Field(ge=0)] = 30
    """Further initial points of the search, where it fails, and for all solutions."""
    # ours
    end_site_name: str | None = dataclasses.field(default=None, kw_only=True)
    """A site of the file that is the tool point, instead of `end_link_name`."""
    posture: dict[str, float] | None = dataclasses.field(default=None, kw_only=True)
    """Joint-name regex -> position (rad or m) that a redundant arm approaches in its null space;
    joints that are not matched have no preference."""
    closed_form: bool = dataclasses.field(default=True, kw_only=True)
    """Whether to use the closed form where there is one."""
