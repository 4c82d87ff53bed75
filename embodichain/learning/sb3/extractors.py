"""`SmallCnn`: features of small images and numbers, for policies named ``MultiInputPolicy``."""

from __future__ import annotations

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.preprocessing import get_flattened_obs_dim, is_image_space
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

__all__ = ["EXTRACTORS", "SmallCnn"]

_LAYERS = ((16, 5, 4), (32, 3, 2), (32, 3, 2))
"""Channels, kernel size and stride of each convolution."""


class SmallCnn(BaseFeaturesExtractor):
    """Three convolutions for each image, then one layer; numbers are passed on beside it.

    For three channels of 64x64 pixels it has 48,000 weights, Stable-Baselines3's `NatureCNN`
    600,000.

    Args:
        observation_space: A Dict of images (uint8, channels first) and of vectors, or one image.
        features: Width of the layer after the convolutions of each image.
    """

    def __init__(self, observation_space: spaces.Space[Any], features: int = 64) -> None:
        alone = {"": observation_space}
        parts = observation_space.spaces if isinstance(observation_space, spaces.Dict) else alone
        images = {key: space for key, space in parts.items() if is_image_space(space)}
        width = features * len(images) + sum(
            get_flattened_obs_dim(space) for key, space in parts.items() if key not in images
        )
        super().__init__(observation_space, width)
        self._keys = list(parts)
        self._names = {key: f"image{number}" for number, key in enumerate(images)}
        networks = {self._names[key]: _network(space, features) for key, space in images.items()}
        self.networks = nn.ModuleDict(networks)  # a key of a module has no "/"

    def forward(self, observations: Any) -> torch.Tensor:
        """(B, features_dim) features of B observations, as Stable-Baselines3 scales them."""
        parts = observations if isinstance(observations, dict) else {"": observations}
        found = [
            self.networks[self._names[key]](parts[key])
            if key in self._names
            else parts[key].flatten(1)
            for key in self._keys
        ]
        return torch.cat(found, dim=1)


def _network(space: Any, features: int) -> nn.Module:
    layers: list[nn.Module] = []
    channels = space.shape[0]
    for width, kernel, stride in _LAYERS:
        layers += [nn.Conv2d(channels, width, kernel, stride, padding=kernel // 2), nn.ReLU()]
        channels = width
    layers.append(nn.Flatten())
    with torch.no_grad():
        count = nn.Sequential(*layers)(torch.zeros(1, *space.shape)).shape[1]
    return nn.Sequential(*layers, nn.Linear(count, features), nn.ReLU())


EXTRACTORS: dict[str, type[BaseFeaturesExtractor]] = {"small_cnn": SmallCnn}
"""Features extractors of this package, by the names that a config has for them."""
