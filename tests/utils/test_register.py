"""`Register`: the door that things of this package and of other packages come through."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from embodichain.utils.errors import ConfigError
from embodichain.utils.register import Register

GROUP = "embodichain.animals"
PLUGIN = """
import zoo

@zoo.ANIMALS.add({names})
class {cls}:
    pass
"""


@pytest.fixture
def zoo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Register[type]]:
    """A package with a register of animals and one module of its own, which has a heron."""
    (tmp_path / "zoo.py").write_text(
        "from embodichain.utils.register import Register\n"
        f"ANIMALS = Register('animal', group={GROUP!r}, modules=['zoo_birds'])\n"
    )
    (tmp_path / "zoo_birds.py").write_text(PLUGIN.format(names='"heron"', cls="Heron"))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield __import__("zoo").ANIMALS
    for name in [name for name in sys.modules if name.startswith(("zoo", "guest"))]:
        del sys.modules[name]


def install(folder: Path, module: str, source: str) -> None:
    """Install a package the way pip leaves it on disk."""
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{module} = {module}\n")
    (folder / f"{module}.py").write_text(source)


def test_modules_are_imported_at_the_first_lookup(zoo: Register[type], tmp_path: Path) -> None:
    install(tmp_path, "guest_fish", PLUGIN.format(names='"trout", "Trout"', cls="Trout"))
    assert "zoo_birds" not in sys.modules
    assert list(zoo) == ["heron", "trout", "Trout"]
    assert zoo["trout"] is zoo["Trout"] is sys.modules["guest_fish"].Trout
    assert zoo.place("heron") == "zoo_birds:Heron"
    assert len(zoo) == 3
    assert "heron" in zoo
    assert "stork" not in zoo
    assert zoo.get("stork") is None


def test_an_unknown_name_gets_the_closest_one(zoo: Register[type]) -> None:
    with pytest.raises(ConfigError) as caught:
        zoo["herron"]
    message = "unknown animal 'herron'; there are: heron. Did you mean 'heron'?"
    assert str(caught.value) == message


def test_a_broken_package_is_named_and_the_others_work(
    zoo: Register[type], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    install(tmp_path, "guest_broken", "raise RuntimeError('no licence')")
    install(tmp_path, "guest_fish", PLUGIN.format(names='"trout"', cls="Trout"))
    reason = (
        "the animals of 'guest_broken' (entry point 'guest_broken' of guest_broken) could not be "
        "loaded: RuntimeError: no licence"
    )
    assert list(zoo) == ["heron", "trout"]
    assert zoo.broken == (reason,)
    assert caplog.messages == [reason]
    with pytest.raises(ConfigError, match=r"unknown animal 'stork'.*Besides, the animals of"):
        zoo["stork"]


def test_a_name_belongs_to_one_object(zoo: Register[type], tmp_path: Path) -> None:
    install(tmp_path, "guest_birds", PLUGIN.format(names='"heron"', cls="GreyHeron"))
    assert list(zoo) == ["heron"]
    clash = "animal 'heron' of guest_birds:GreyHeron is registered already, by zoo_birds:Heron"
    assert clash in zoo.broken[0]


def test_a_clash_registers_none_of_the_names(zoo: Register[type]) -> None:
    list(zoo)
    with pytest.raises(ValueError, match=r"is registered already, by zoo_birds:Heron"):
        zoo.add("egret", "heron")(type("Egret", (), {}))
    assert "egret" not in zoo


def test_instances_are_told_apart_by_the_line_that_registers_them(zoo: Register[type]) -> None:
    first = zoo.add("eagle")(object())
    assert zoo["eagle"] is first
    with pytest.raises(ValueError, match=r"test_register:\d+ is registered already, by .*:\d+"):
        zoo.add("eagle")(object())


def test_a_module_of_ours_that_fails_fails_every_lookup(
    zoo: Register[type], tmp_path: Path
) -> None:
    (tmp_path / "zoo_birds.py").write_text("raise RuntimeError('unfinished')")
    for _ in range(2):
        with pytest.raises(RuntimeError, match="unfinished"):
            zoo["heron"]


def test_a_module_may_look_things_up_while_it_is_imported(
    zoo: Register[type], tmp_path: Path
) -> None:
    source = PLUGIN.format(names='"trout"', cls="Trout") + "assert 'heron' in zoo.ANIMALS\n"
    install(tmp_path, "guest_fish", source)
    assert list(zoo) == ["heron", "trout"]
    assert zoo.broken == ()


def test_names_have_the_order_of_the_modules(tmp_path: Path, zoo: Register[type]) -> None:
    (tmp_path / "zoo_fish.py").write_text(PLUGIN.format(names='"trout"', cls="Trout"))
    (tmp_path / "zoo.py").write_text(
        "from embodichain.utils.register import Register\n"
        f"ANIMALS = Register('animal', group={GROUP!r}, modules=['zoo_fish', 'zoo_birds'])\n"
    )
    del sys.modules["zoo"]
    __import__("zoo_birds")  # by someone who needs it alone
    assert list(sys.modules["zoo"].ANIMALS) == ["trout", "heron"]


def test_the_revision_changes_with_every_addition(zoo: Register[type]) -> None:
    before = zoo.revision
    assert zoo.revision == before
    zoo.add("eagle")(object())
    assert zoo.revision > before


@pytest.fixture
def aquarium(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Register[str]]:
    """A package that is searched for modules, which has a carp and an eel."""
    (tmp_path / "zoo_tank").mkdir()
    (tmp_path / "zoo_tank" / "__init__.py").touch()
    (tmp_path / "zoo_fish.py").write_text(
        "from embodichain.utils.register import Register\n"
        f"FISH = Register('fish', group={GROUP!r}, modules=['zoo_tank.*'])\n"
        "def fish(name):\n"
        "    def decorate(function):\n"
        "        FISH.add(name, describes=function)(function())\n"
        "        return function\n"
        "    return decorate\n"
    )
    for name in ("carp", "eel", "_water"):
        (tmp_path / "zoo_tank" / f"{name}.py").write_text(
            f'"""The {name}.\n\nMore of it."""\nimport zoo_fish\n'
            f"@zoo_fish.fish('{name}')\ndef swim():\n    return '{name} swims'\n"
        )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield __import__("zoo_fish").FISH
    for name in [name for name in sys.modules if name.startswith(("zoo", "guest"))]:
        del sys.modules[name]


def test_names_and_summaries_import_no_module(aquarium: Register[str], tmp_path: Path) -> None:
    install(tmp_path, "guest_pike", "def broken(:")
    assert aquarium.names() == ("carp", "eel", "guest_pike")
    assert aquarium.summaries() == {"carp": "The carp.", "eel": "The eel.", "guest_pike": ""}
    assert not {"zoo_tank.carp", "zoo_tank.eel", "guest_pike"} & set(sys.modules)


def test_names_have_the_order_of_modules_whatever_was_imported_first(
    aquarium: Register[str],
) -> None:
    __import__("zoo_tank.eel")
    assert list(aquarium) == ["carp", "eel"]
    assert aquarium["eel"] == "eel swims"


def test_what_describes_a_function_is_told_apart_by_it(
    aquarium: Register[str], tmp_path: Path
) -> None:
    source = "import zoo_fish\n@zoo_fish.fish('carp')\ndef jump():\n    return 'jumps'\n"
    install(tmp_path, "guest_carp", source)
    assert aquarium["carp"] == "carp swims"
    assert "'carp' of guest_carp:jump is registered already, by zoo_tank.carp:swim" in str(
        aquarium.broken
    )
