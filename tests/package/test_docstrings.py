"""Public docstrings follow numpydoc."""

import importlib
import inspect
import pkgutil

import numpydoc.validate
import pytest

import spectra_kit

# No extended summary or see-also is forced; records document their fields as attributes (PR01);
# formulas and Greek letters may begin a description (PR08, RT04); summaries may be noun phrases.
IGNORED = {"ES01", "SA01", "EX01", "PR01", "PR08", "RT04", "SS05"}


def public_names() -> list[str]:
    """Dotted names of everything that a public package exports."""
    names = [f"spectra_kit.{name}" for name in dir(spectra_kit)]
    for module in pkgutil.iter_modules(spectra_kit.__path__, "spectra_kit."):
        if module.ispkg and not module.name.split(".")[-1].startswith("_"):
            exported = getattr(importlib.import_module(module.name), "__all__", [])
            names += [f"{module.name}.{name}" for name in exported]
    unique = {}
    for name in names:
        parent, _, attribute = name.rpartition(".")
        thing = getattr(importlib.import_module(parent), attribute)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            unique.setdefault(id(thing), name)
    return sorted(unique.values())


@pytest.mark.parametrize("name", public_names())
def test_docstring(name: str) -> None:
    found = numpydoc.validate.validate(name)
    # Arguments that are those of another function have their types there (PR04).
    borrowed = {"PR04"} if "\n    As of `" in found["docstring"] else set()
    errors = [f"{code}: {text}" for code, text in found["errors"] if code not in IGNORED | borrowed]
    assert not errors, errors
    parent, _, attribute = name.rpartition(".")
    thing = getattr(importlib.import_module(parent), attribute)
    doc = inspect.getdoc(thing) or ""
    if inspect.isfunction(thing) and inspect.signature(thing).return_annotation != "None":
        assert "Returns" in doc or doc.startswith("Return")
    if ".viz." in name:
        assert "$" not in doc, "a name that viz.picture does not know"
