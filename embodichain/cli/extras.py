"""Optional packages and what each is for; which versions, `pyproject.toml` says. Imports none."""

from __future__ import annotations

import importlib.metadata as metadata
from dataclasses import dataclass

__all__ = ["EXTRAS", "Extra"]


@dataclass(frozen=True, slots=True)
class Extra:
    """Packages that are installed together.

    Attributes:
        packages: Their names; what they need besides is not listed.
        purpose: What they are for.
        install: What pip is told.
    """

    packages: tuple[str, ...]
    purpose: str
    install: str

    def found(self) -> tuple[dict[str, str], list[str]]:
        """Return the versions of those that are installed, and the names of those that are not."""
        versions: dict[str, str] = {}
        missing: list[str] = []
        for name in self.packages:
            try:
                versions[name] = metadata.version(name)
            except metadata.PackageNotFoundError:
                missing.append(name)
        return versions, missing


def _extra(name: str, purpose: str, *packages: str) -> tuple[str, Extra]:
    return name, Extra(packages, purpose, f"'embodichain[{name}]'")


def _alone(package: str, purpose: str) -> tuple[str, Extra]:
    return package, Extra((package,), purpose, package)


EXTRAS: dict[str, Extra] = dict(
    (
        _extra("robots", "robots of example-robot-data", "example-robot-data"),
        _extra("decompose", "convex parts of meshes: collision: decompose", "coacd"),
        _extra("plot", "curves of trainings as PNG", "matplotlib"),
        _alone("tensorboard", "event files of trainings"),
        _extra("wandb", "trainings in Weights & Biases", "wandb"),
        _alone("sb3-contrib", "algorithms TRPO, TQC, CrossQ, RecurrentPPO"),
        _extra(
            "sweep",
            "sweeps in parallel, and searches with Optuna",
            *("hydra-joblib-launcher", "hydra-optuna-sweeper", "alembic", "sqlalchemy"),
        ),
        _extra("export", "policies as ONNX files", "onnx", "onnxruntime"),
        _extra("video", "films: video=true, replay --video", "imageio-ffmpeg"),
        _extra("foxglove", "viewer=foxglove", "foxglove-sdk"),
        _extra("pandas", "logs as data frames", "pandas"),
        _extra("parquet", "logs as Parquet files", "pyarrow"),
        _extra("hdf5", "logs as HDF5 files", "h5py"),
        _extra("ros2", "logs as ROS 2 bags", "rosbags"),
        _extra("rerun", "logs as recordings for Rerun", "rerun-sdk"),
        _extra("lerobot", "logs as LeRobot data sets", "pandas", "pyarrow", "imageio-ffmpeg"),
    )
)
"""By the extra's name; by the package's where it has none."""
