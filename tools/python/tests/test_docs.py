"""Every example in the documentation runs, and every public name is documented."""

from __future__ import annotations

import doctest
import inspect
import pathlib
import shutil
import sys
import warnings

import numpy as np
import pytest

import slicewalk

PAGE = pathlib.Path(__file__).parent.parent / "README.md"


def documented():
    """Names and docstrings of the public interface."""
    yield "slicewalk", slicewalk.__doc__
    yield "slicewalk.errors", slicewalk.errors.__doc__
    for name in slicewalk.__all__:
        thing = getattr(slicewalk, name)
        if not (inspect.isclass(thing) or callable(thing)):
            continue
        yield name, thing.__doc__
        for member, value in vars(thing).items() if inspect.isclass(thing) else ():
            is_member = callable(value) or isinstance(value, property) or inspect.isgetsetdescriptor(value)
            if is_member and not member.startswith("_"):
                yield f"{name}.{member}", value.__doc__


TEXTS = dict(documented())


@pytest.mark.parametrize("name", TEXTS)
def test_everything_is_documented(name):
    assert TEXTS[name], name


@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if ">>>" in (text or "")])
def test_examples(name, folder, tmp_path, monkeypatch):
    for file in ("room.las", "room.slices", "seen.slices"):
        shutil.copy(folder / file, tmp_path)
    monkeypatch.chdir(tmp_path)
    names = {"slicewalk": slicewalk, "np": np}
    test = doctest.DocTestParser().get_doctest(TEXTS[name], names, name, None, 0)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    runner.run(test, out=sys.stderr.write)
    assert runner.tries > 0
    assert runner.failures == 0


def test_script_of_the_page(folder, tmp_path, monkeypatch):
    text = PAGE.read_text()
    script = text.split("```python\n")[1].split("```")[0]
    assert len(script.splitlines()) == 12
    shutil.copy(folder / "room.las", tmp_path / "scan.laz")
    shutil.move(tmp_path / "scan.laz", tmp_path / "scan.las")
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("matplotlib").use("Agg")
    with warnings.catch_warnings():
        # The scan states no unit.
        warnings.simplefilter("ignore", slicewalk.SlicewalkWarning)
        exec(compile(script, str(PAGE), "exec"), {})
    assert (tmp_path / "slice.png").read_bytes().startswith(b"\x89PNG")
