"""Every functor that EmbodiChain documents is a term here with its parameters, or is listed."""

from pathlib import Path

import pytest
import yaml

from embodichain.compat.gym_config.conversion import convert
from embodichain.compat.gym_config.functors import OF_CAMERA
from embodichain.lab.gym.envs.managers.terms.registry import TERMS

FUNCTORS = yaml.safe_load(Path(__file__).with_name("functors.yaml").read_text())


@pytest.mark.parametrize(("kind", "name"), [(k, n) for k in FUNCTORS for n in FUNCTORS[k]])
def test_functor_is_a_term_or_listed(kind: str, name: str) -> None:
    params = dict.fromkeys(FUNCTORS[kind][name], 1)
    functor = {"func": name, "params": params}
    conversion = convert({"robot": {"fpath": "a.urdf"}, "env": {f"{kind}s": {"it": functor}}})
    assert conversion.problems == ()
    listed = {note.path for note in conversion.notes}
    made = conversion.task.get(f"{kind}s")
    if made is None:
        assert listed == {f"env.{kind}s.it"}
        return
    func = made["it"]["func"]
    spec = TERMS[kind][func]  # type: ignore[index]
    given = made["it"].get("params", {})
    assert set(spec.written(given)) == set(given)
    names = OF_CAMERA.get(func, {}) if kind == "event" else {}
    left = [key for key in params if names.get(key, key) not in given]
    assert {f"env.{kind}s.it.params.{key}" for key in left} == listed
