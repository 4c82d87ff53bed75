"""Configs of physics and of its memory: the options that all environments share. Pure data.

Names, order and defaults are EmbodiChain 0.2.1's; fields after `# ours` are MuJoCo's, by the names
of its ``<option>``. `cfg` exports these classes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from embodichain.lab.sim.configs.contact_cfg import Coefficient, Solimp, Solref
from embodichain.lab.sim.configs.scene_cfg import Vec3
from embodichain.utils.configclass import configclass
from embodichain.utils.fields.no_effect import NoEffect

__all__ = ["FlagsCfg", "GPUMemoryCfg", "OptionsCfg", "PhysicsCfg", "RenderCfg"]


@configclass
class RenderCfg:
    """Renderer choice. All of EmbodiChain's values are accepted; MuJoCo's renderer draws."""

    renderer: Literal["hybrid", "fast-rt", "rt", "auto", "no-render"] = "hybrid"
    enable_denoiser: bool = True
    """No effect: MuJoCo rasterizes."""
    spp: int = 64
    """No effect: MuJoCo rasterizes."""


_PHYSX = NoEffect("a PhysX setting; MuJoCo has none like it")
_Count = Annotated[int, Field(ge=0)]
_Iterations = Annotated[int, Field(ge=1)]
_Vector = Annotated[
    Sequence[Annotated[float, Field(allow_inf_nan=False)]], Field(min_length=3, max_length=3)
]
_Switch = Literal["enable", "disable"] | None


@configclass(kw_only=True)
class FlagsCfg:
    """Parts of MuJoCo's pipeline that are switched on or off, as by its ``<flag>``.

    None is MuJoCo's default: the first group is enabled, the second one, from `override`, is not.
    `autoreset` is not among them: a diverged environment is reset here, not by MuJoCo.
    """

    constraint: _Switch = None
    equality: _Switch = None
    frictionloss: _Switch = None
    limit: _Switch = None
    contact: _Switch = None
    spring: _Switch = None
    damper: _Switch = None
    gravity: _Switch = None
    clampctrl: _Switch = None
    warmstart: _Switch = None
    filterparent: _Switch = None
    actuation: _Switch = None
    refsafe: _Switch = None
    sensor: _Switch = None
    midphase: _Switch = None
    eulerdamp: _Switch = None
    nativeccd: _Switch = None
    island: _Switch = None
    multiccd: _Switch = None
    override: _Switch = None
    energy: _Switch = None
    fwdinv: _Switch = None
    invdiscrete: _Switch = None
    sleep: _Switch = None
    diagexact: _Switch = None
    ipc: _Switch = None
    speculative: _Switch = None


@configclass(kw_only=True)
class OptionsCfg:
    """Options of MuJoCo's ``<option>`` that seldom change; None is MuJoCo's default."""

    wind: _Vector | None = None
    """m/s, velocity of the medium."""
    density: Coefficient | None = None
    """kg/m^3 of the medium: lift and drag; 1.2 is air, 1000 water."""
    viscosity: Coefficient | None = None
    """Pa s of the medium; 0.00002 is air, 0.0009 water."""
    magnetic: _Vector | None = None
    """Magnetic flux, for magnetometers."""
    jacobian: Literal["dense", "sparse", "auto"] | None = None
    tolerance: Coefficient | None = None
    """Improvement at which the solver stops early."""
    ls_iterations: _Iterations | None = None
    """Maximum number of iterations of each line search."""
    ls_tolerance: Coefficient | None = None
    noslip_iterations: _Count | None = None
    """Maximum number of iterations after the solver that suppress slip; 0 is none."""
    noslip_tolerance: Coefficient | None = None
    ccd_iterations: _Iterations | None = None
    """Maximum number of iterations of the collision of convex shapes."""
    ccd_tolerance: Coefficient | None = None
    sdf_iterations: _Iterations | None = None
    sdf_initpoints: _Iterations | None = None
    sleep_tolerance: Coefficient | None = None
    """m/s, of bodies that may sleep; needs ``flags: {sleep: enable}``."""
    o_margin: Coefficient | None = None
    """Metres: the margin of all contacts; needs ``flags: {override: enable}``, as do `o_solref`,
    `o_solimp` and `o_friction`."""
    o_solref: Solref | None = None
    o_solimp: Solimp | None = None
    o_friction: Annotated[Sequence[Coefficient], Field(min_length=1, max_length=5)] | None = None
    """Two sliding, a torsional and two rolling coefficients, or the first of these."""
    flags: FlagsCfg | None = None
    """Parts of the pipeline that are switched on or off."""


@configclass
class PhysicsCfg(OptionsCfg):
    """Physics options; the PhysX ones have no effect on MuJoCo."""

    gravity: Vec3 = dataclasses.field(default_factory=lambda: [0.0, 0.0, -9.81])
    """m/s^2, world frame."""
    bounce_threshold: Annotated[float, _PHYSX] = 2.0
    """No effect."""
    enable_pcm: Annotated[bool, _PHYSX] = True
    """No effect."""
    enable_tgs: Annotated[bool, _PHYSX] = True
    """No effect."""
    enable_ccd: Annotated[bool, _PHYSX] = False
    """No effect."""
    enable_enhanced_determinism: Annotated[bool, _PHYSX] = False
    """No effect: always deterministic."""
    enable_friction_every_iteration: Annotated[bool, _PHYSX] = True
    """No effect."""
    length_tolerance: Annotated[float, _PHYSX] = 0.05
    """No effect."""
    speed_tolerance: Annotated[float, _PHYSX] = 0.25
    """No effect."""
    # ours
    solver: Literal["Newton", "CG", "PGS"] = dataclasses.field(default="Newton", kw_only=True)
    iterations: int = dataclasses.field(default=100, kw_only=True)
    """Maximum number of solver iterations per physics step."""
    integrator: Literal["implicitfast", "implicit", "Euler", "RK4"] = dataclasses.field(
        default="implicitfast", kw_only=True
    )
    cone: Literal["pyramidal", "elliptic"] = dataclasses.field(default="pyramidal", kw_only=True)
    impratio: Annotated[float, Field(gt=0, allow_inf_nan=False)] = dataclasses.field(
        default=1.0, kw_only=True
    )
    """Stiffness of friction over that of contact; an elliptic cone and 10 stop creep in grasps."""


@configclass
class GPUMemoryCfg:
    """PhysX buffer sizes. No effect."""

    temp_buffer_capacity: int = 2**24
    max_rigid_contact_count: int = 2**19
    max_rigid_patch_count: int = 2**18
    heap_capacity: int = 2**26
    found_lost_pairs_capacity: int = 2**25
    found_lost_aggregate_pairs_capacity: int = 2**10
    total_aggregate_pairs_capacity: int = 2**10
