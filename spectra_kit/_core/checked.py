"""The annotations of public functions, held at run time: arguments of a wrong kind are refused.

A kind is what an annotation tells: a `Laplacian`, an integer, one of some words. What it cannot
tell (ranges, shapes) is checked inside, by `validate`. A class with a static method ``_made_of``
says what else it may be given as: that is how files and other toolkits' meshes become geometries.
"""

from __future__ import annotations

import inspect
import os
import sys
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import wraps
from itertools import chain, repeat
from types import UnionType
from typing import Annotated, Any, Literal, NewType, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit.errors import InvalidFileError, InvalidInputError

Target = TypeVar("Target", bound=Callable[..., Any])


def checked(target: Target) -> Target:
    """Refuse arguments of the wrong kind, by name, where `target` is called.

    Of a class: those of its constructor and of its public methods. ``Annotated[X, Y]`` is an X that
    may be given as a Y. It stands where users enter: on what the reference lists, and nowhere else.
    """
    if not isinstance(target, type):
        return cast(Target, _checked_function(target))
    for name, member in list(vars(target).items()):
        if name.startswith("_") and name not in ("__init__", "__call__"):
            continue
        if inspect.isfunction(member):
            setattr(target, name, _checked_function(member))
        elif isinstance(member, classmethod):
            setattr(target, name, classmethod(_checked_function(member.__func__)))
    return target


def _checked_function(function: Callable[..., Any]) -> Callable[..., Any]:
    signature: _Signature | None = None
    called = function.__qualname__.removesuffix(".__init__")

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        nonlocal signature
        if signature is None:  # at the first call: annotations may name what is defined below
            signature = _signature(function)
        positional, rest, by_name, names, kinds = signature
        if len(args) > len(positional) and by_name and not rest:
            raise InvalidInputError(
                f"{called} takes its options by name", advice=f"write {called}({by_name[0]}=...)"
            )
        for name in options:
            if names and name not in names:
                near = get_close_matches(name, names, 1)
                hint = f"; did you mean `{near[0]}`?" if near else ""
                raise TypeError(f"{called} takes no argument `{name}`{hint}")
        given = [*zip(chain(positional, repeat(rest)), args, strict=False), *options.items()]
        for i, (name, value) in enumerate(given):
            kind = kinds.get(name)
            fits = kind is None or kind.accepts(value)
            if fits and not isinstance(value, np.str_):
                continue
            # A word of NumPy's is passed on as Python's: what is kept of it goes by its repr.
            made = str(value) if fits else _made(name, value, kinds, dict(given))
            if i < len(args):
                args = (*args[:i], made, *args[i + 1 :])
            else:
                options[name] = made
        return function(*args, **options)

    return call


@dataclass(frozen=True)
class _Kind:
    """What an argument may be: in words, and as a test."""

    words: tuple[str, ...]  # each is enough: "Laplacian", "'upper'", "None"
    accepts: Callable[[Any], bool]
    article: bool = True  # before the first word
    several: str = "values"  # what to call more than one
    numeric: bool = False  # an array, of whose entries the words are
    held: Callable[[Any], Iterator[tuple[object, Any, _Kind]]] | None = None  # where, what, which
    lack: str = ""  # of what is no such thing
    advice: str = ""
    made_of: Callable[[Any], Any] | None = None  # makes it of other things

    @property
    def expected(self) -> str:
        """What follows "must"."""
        if self.numeric:
            return f"hold {_listed(self.words)}"
        return f"be {self.one}"

    @property
    def one(self) -> str:
        """What to call one."""
        return _with_article(_listed(self.words)) if self.article else _listed(self.words)


class _Torch:
    """Stands for torch in annotations: it is imported only where something is computed with it."""

    dtype = Any
    Tensor = NewType("Tensor", object)
    device = NewType("device", object)


_Signature = tuple[list[str], str, list[str], list[str], dict[str, _Kind]]
_LATE = {"torch": _Torch, "Figure": Any}  # Matplotlib's, imported where something is drawn


def _signature(function: Callable[..., Any]) -> _Signature:
    """Return names of positional arguments, of ``*args``, of those by name alone; all; and kinds.

    There is no list of all names where others are taken, too.
    """
    parameters = inspect.signature(function).parameters.values()
    hints = typing.get_type_hints(function, localns=_LATE, include_extras=True)
    # NaN is no number to compute with, but a record may hold it, where there is nothing to tell.
    record = function.__name__ == "__init__"
    for p in parameters:
        if hints.get(p.name) is float and (record or p.default != p.default):
            hints[p.name] = _NUMBER_OR_NAN
    kinds = {p.name: _kind(hints.get(p.name, Any)) for p in parameters}

    def names(kind: Any) -> list[str]:
        return [p.name for p in parameters if p.kind is kind]

    return (
        names(inspect.Parameter.POSITIONAL_OR_KEYWORD),
        "".join(names(inspect.Parameter.VAR_POSITIONAL)),
        names(inspect.Parameter.KEYWORD_ONLY),
        [] if names(inspect.Parameter.VAR_KEYWORD) else [*kinds],
        {name: kind for name, kind in kinds.items() if kind is not None},
    )


def _kind(hint: Any) -> _Kind | None:
    """Return the kind that an annotation asks for; None where it asks for none in particular."""
    if isinstance(hint, TypeVar):
        hint = hint.__bound__ or typing.Union[hint.__constraints__ or (Any,)]  # noqa: UP007
    if hint in _SCALARS:
        return _SCALARS[hint]
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        arrays = [_numbers("fiu")] if set(args) >= _ARRAY_LIKE else []  # a union itself
        return _either([*arrays, *(_kind(a) for a in args if not arrays or a not in _ARRAY_LIKE)])
    if origin is Annotated:  # what follows the type may be given instead of it
        said, *others = map(_kind, args)
        accepted = [kind.accepts for kind in (said, *others) if kind is not None]
        return said and replace(said, accepts=lambda v: any(accepts(v) for accepts in accepted))
    if origin is Literal:
        words = tuple(map(repr, args))
        return _Kind(
            words,
            lambda v: any(type(v) in (type(a), np.str_) and v == a for a in args),
            article=False,
            several=_listed(words),
        )
    base = hint if origin is None else origin
    if not isinstance(base, type) or base is object:
        return None
    if base is np.ndarray:
        return _numbers(_letters(typing.get_args(args[1])[0]), scalar=False)
    if origin is Callable:
        return _Kind(("function",), lambda v: callable(v) and not isinstance(v, type))
    if issubclass(base, tuple) and args:
        return _sequence(base, args)
    if issubclass(base, Mapping) and args:
        return _mapping(args)
    if issubclass(base, Sequence) and args:
        return _sequence(base, (*args, ...))
    if issubclass(base, sparse.sparray):
        return _Kind(("scipy sparse array",), sparse.issparse, several="scipy sparse arrays")
    if issubclass(base, os.PathLike):
        return _Kind(("path",), lambda v: isinstance(v, str | os.PathLike), several="paths")
    lack, advice = _ADVICE.get(base.__name__, ("", ""))
    return _Kind(
        (base.__name__,),
        lambda v: isinstance(v, base) and not isinstance(v, type),
        several=f"{base.__name__}s",
        lack=lack,
        advice=advice,
        made_of=getattr(base, "_made_of", MADE_OF.get(base)),
    )


def _is_integer(value: Any) -> bool:
    """Whether this is an integer that NumPy can hold."""
    return isinstance(value, np.integer) or (
        isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63
    )


_FLOATS = float, np.floating


def _is_number(value: Any) -> bool:
    return isinstance(value, _FLOATS) or _is_integer(value)  # a record holds many floats


def _is_tensor(value: Any) -> bool:
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


_NUMBER_OR_NAN = NewType("_NUMBER_OR_NAN", float)
_NONE = _Kind(("None",), lambda v: v is None, article=False)
_NUMBER = _Kind(("number",), _is_number, several="numbers")
_SCALARS = {
    Any: None,
    None: _NONE,
    type(None): _NONE,
    bool: _Kind(("True", "False"), lambda v: isinstance(v, bool | np.bool_), article=False),
    int: _Kind(("integer",), _is_integer, several="integers"),
    float: replace(_NUMBER, accepts=lambda v: _is_number(v) and v == v),
    _NUMBER_OR_NAN: _NUMBER,
    str: _Kind(("string",), lambda v: isinstance(v, str), several="strings"),
    # Torch is not imported for these: there is no tensor without it, and a device has a name.
    _Torch.Tensor: _Kind(("Tensor",), _is_tensor),
    _Torch.device: _Kind(("torch.device",), lambda v: str(type(v)) == "<class 'torch.device'>"),
}
_ARRAY_LIKE = set(typing.get_args(ArrayLike))


def _letters(dtype: Any) -> str:
    """Return the kinds of dtype, in NumPy's letters, that an array of `dtype` may be given in."""
    if parts := typing.get_args(dtype):
        return "".join(map(_letters, parts))
    if dtype is np.bool_:
        return "b"
    return "iu" if isinstance(dtype, type) and issubclass(dtype, np.integer) else "fiu"


def _numbers(letters: str, *, scalar: bool = True) -> _Kind:
    """Return the kind of an array, or of what NumPy makes one of; its shape is no matter here."""

    def accepts(value: Any) -> bool:
        try:
            array = np.asarray(value)
        # Rows of several lengths; a tensor on another device, or one whose gradient is wanted.
        except (ValueError, TypeError, RuntimeError):
            return False
        if (array.ndim == 0 and not scalar) or np.ma.is_masked(value):
            return False
        return array.dtype.kind in letters or (array.size == 0 and array.dtype.kind == "f")

    words, advice = ("real numbers", "") if "f" in letters else ("integers", "count from 0")
    several = f"arrays of {words}"
    return _Kind((words,), accepts, several=several, numeric=True, advice=advice)


def _either(kinds: Sequence[_Kind | None]) -> _Kind | None:
    """Return the kind of what is one of several; what holds others is told apart inside."""
    some = [kind for kind in kinds if kind is not None]
    proper = [kind for kind in some if kind is not _NONE]
    if len(some) < len(kinds) or (len(proper) > 1 and any(k.numeric or k.held for k in proper)):
        return None
    return replace(
        some[0],
        words=tuple(word for kind in some for word in kind.words),
        accepts=lambda v: any(kind.accepts(v) for kind in some),
        several=" or ".join(kind.several if kind is not _NONE else "None" for kind in some),
    )


def _sequence(base: type, args: tuple[Any, ...]) -> _Kind:
    kinds = [_kind(a) for a in args if a is not ...]
    size = None if args[-1] is ... else len(kinds)

    def is_one(value: Any) -> bool:
        if isinstance(value, np.ndarray):
            return value.ndim > 0 and size in (None, len(value))
        listed = isinstance(value, Sequence) and not isinstance(value, str | bytes)
        return listed and size in (None, len(value))

    def held(value: Any) -> Iterator[tuple[object, Any, _Kind]]:
        each = repeat(kinds[0]) if size is None else kinds
        for place, (kind, item) in enumerate(zip(each, value, strict=False)):
            if kind is not None:
                yield place, item, kind

    of = f"{size} {_several(kinds[0])}" if size else _several(kinds[0])
    if len({_several(kind) for kind in kinds}) > 1:
        of = " and ".join("anything" if kind is None else kind.one for kind in kinds)
    return _holding(f"{base.__name__.lower()} of {of}", is_one, held, kinds[0])


def _mapping(args: tuple[Any, ...]) -> _Kind:
    key, item = map(_kind, args)

    def held(value: Any) -> Iterator[tuple[object, Any, _Kind]]:
        for name, thing in value.items():
            if key is not None:
                yield name, name, key
            if item is not None:
                yield name, thing, item

    def accepts(value: Any) -> bool:  # one by one, `held` would take longer than what it looks at
        return (
            isinstance(value, Mapping)
            and (key is None or all(map(key.accepts, value)))
            and (item is None or all(map(item.accepts, value.values())))
        )

    words = f"mapping of {_several(key)} to {_several(item)}"
    return replace(_holding(words, lambda v: isinstance(v, Mapping), held, item), accepts=accepts)


def _holding(
    words: str,
    is_one: Callable[[Any], bool],
    held: Callable[[Any], Iterator[tuple[object, Any, _Kind]]],
    item: _Kind | None,
) -> _Kind:
    return _Kind(
        (words,),
        lambda v: is_one(v) and all(kind.accepts(thing) for _, thing, kind in held(v)),
        held=lambda v: held(v) if is_one(v) else iter(()),
        advice=item.advice if item else "",
    )


def _several(kind: _Kind | None) -> str:
    return "values" if kind is None else kind.several


def _listed(words: Sequence[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last


#: By the name of a class: what others lack to be of it, and what to do.
_ADVICE = {
    "Laplacian": ("", "build one with laplacian(geometry)"),
    "Spectrum": ("", "solve for one: spectrum(mesh, 50)"),
    "Prepared": ("", "pass prepare(spectrum, geometry), or a spectrum with its geometry by name"),
    "Eigensolver": ("which has no method eigenpairs(laplacian, k)", "pass one such as Arpack()"),
    "Subspace": (
        "which is no function of points and mass",
        "pass one such as AmbientFourier() or Neo().subspace, or wrap columns that you have in"
        " GivenBasis(columns)",
    ),
    "Truth": ("", "where a point map is the truth, Truth.of_map(point_map)"),
    "MapErrors": (
        "which does not say at which points they are",
        "pass map_errors(source, point_map, truth), or MapErrors(errors, points)",
    ),
}


#: What makes others into one of a class that is a protocol, and can have no `_made_of` of its own.
MADE_OF: dict[type, Callable[[Any], Any]] = {}
_RAGGED = "rows of several lengths"


def _made(name: str, value: Any, kinds: Mapping[str, _Kind], given: Mapping[str, Any]) -> Any:
    """Return what the argument must be, made of what arrived; else raise, and say what to do."""
    kind = kinds[name]
    got, lack, advice = _described(value, kind), kind.lack, kind.advice
    if got == _RAGGED:
        raise InvalidInputError(name, "have rows of one length", got)
    if np.ma.is_masked(value):
        n = int(np.ma.getmaskarray(value).sum())
        raise InvalidInputError(name, "be whole", f"{n} masked entries", advice="leave them out")
    for other in kinds.keys() & given.keys() - {name}:
        if kinds[other].accepts(value) and kind.accepts(given[other]):
            raise InvalidInputError(
                name, kind.expected, got, advice=f"did you swap it with `{other}`?"
            )
    if isinstance(value, type):
        lack, advice = "", "pass an instance of it"
    elif isinstance(value, int) and abs(value) > 2**62:
        got, advice = f"{got}, which takes more than 64 bits", ""
    elif kind.made_of is not None:
        try:
            made = kind.made_of(value)
        except InvalidFileError as error:  # as of `read`: with the path, and what is wrong with it
            problem = InvalidInputError(name, kind.expected, got, advice=str(error.problem))
            raise InvalidFileError(error.path, problem) from error
        except InvalidInputError as error:
            told = error.advice if error.argument == "thing" else str(error)
            got = f"{got}, {lack}" if lack else got
            raise InvalidInputError(name, kind.expected, got, advice=told) from error
        if kind.accepts(made):
            return made
        got = f"{got}, which holds a {type(made).__name__}"
    raise InvalidInputError(name, kind.expected, f"{got}, {lack}" if lack else got, advice=advice)


def _described(value: Any, kind: _Kind) -> str:
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if value is None or isinstance(value, bool | int | float | complex | str | np.generic):
        return repr(value) if len(repr(value)) < 60 else f"a long {type(value).__name__}"
    if kind.numeric and isinstance(value, np.ndarray | list | tuple):
        try:
            return f"dtype {np.asarray(value).dtype}"
        except ValueError:
            return _RAGGED
    if kind.held is not None and isinstance(value, Sequence | Mapping):
        whole = len(repr(value)) < 60
        told = repr(value) if whole else _with_article(type(value).__name__)
        for place, item, other in kind.held(value):
            if not other.accepts(item) and not (whole and len(value) == 1):
                return f"{told} whose [{place!r}] is {_described(item, other)}"
        if whole:
            return told
    told = _with_article(type(value).__name__)
    if _is_tensor(value):
        if value.requires_grad:
            told += ", which must be detached first"
        elif value.device.type != "cpu":
            told += f" on {str(value.device)!r}, which must be brought to the host first (.cpu())"
    return told


def _with_article(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"
