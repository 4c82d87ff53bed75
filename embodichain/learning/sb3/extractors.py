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
        entries: dict[str, spaces.Space[Any]] = {"": observation_space}
        if isinstance(observation_space, spaces.Dict):
            entries = observation_space.spaces
        # The key of a module must not contain a "/", as entries do.
        module_keys: dict[str, str] = {}
        networks: dict[str, nn.Module] = {}
        width = 0
        for key, space in entries.items():
            if is_image_space(space):
                module_keys[key] = f"image{len(module_keys)}"
                networks[module_keys[key]] = _network(space, features)
                width += features
            else:
                width += get_flattened_obs_dim(space)
        super().__init__(observation_space, width)
        self._keys = list(entries)
        self._module_keys = module_keys
        self.networks = nn.ModuleDict(networks)

    def forward(self, observations: Any) -> torch.Tensor:
        """(B, features_dim) features of B observations, as Stable-Baselines3 scales them."""
        entries = observations if isinstance(observations, dict) else {"": observations}
        features: list[torch.Tensor] = []
        for key in self._keys:
            if key in self._module_keys:
                network = self.networks[self._module_keys[key]]
                features.append(network(entries[key]))
            else:
                features.append(entries[key].flatten(1))
        return torch.cat(features, dim=1)


def _network(space: Any, features: int) -> nn.Module:
    layers: list[nn.Module] = []
    channels = space.shape[0]
    for width, kernel, stride in _LAYERS:
        layers.append(nn.Conv2d(channels, width, kernel, stride, padding=kernel // 2))
        layers.append(nn.ReLU())
        channels = width
    layers.append(nn.Flatten())
    with torch.no_grad():
        count = nn.Sequential(*layers)(torch.zeros(1, *space.shape)).shape[1]
    return nn.Sequential(*layers, nn.Linear(count, features), nn.ReLU())


EXTRACTORS: dict[str, type[BaseFeaturesExtractor]] = {"small_cnn": SmallCnn}
"""Features extractors of this package, by the names that a config has for them."""
