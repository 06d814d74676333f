"""The annotations of public functions, held at run time: arguments of a wrong kind are refused.

A kind is what an annotation tells: a `Laplacian`, an integer, one of some words. What it cannot
tell (ranges, shapes) is checked inside, by `_validate`.
"""

from __future__ import annotations

import inspect
import os
import re
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from itertools import chain, repeat
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, NewType, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit.errors import InvalidInputError

Target = TypeVar("Target", bound=Callable[..., Any])


def checked(target: Target) -> Target:
    """Refuse arguments of the wrong kind, by name, where `target` is called.

    Of a class: those of its constructor and of its public methods. ``Annotated[X, Y]`` is an X that
    may be given as a Y. The number of arguments is left to Python.

    Examples
    --------
    >>> from typing import Literal
    >>> from spectra_kit._checked import checked
    >>> @checked
    ... def half(n: int, *, side: Literal["upper", "lower"] = "upper") -> int:
    ...     return n // 2
    >>> half(7, side="left")
    Traceback (most recent call last):
    spectra_kit.errors.InvalidInputError: `side` must be 'upper' or 'lower', got 'left'
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

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        nonlocal signature
        if signature is None:  # at the first call: annotations may name what is defined below
            signature = _signature(function)
        positional, rest, kinds = signature
        given = [*zip(chain(positional, repeat(rest)), args, strict=False), *options.items()]
        for name, value in given:
            kind = kinds.get(name)
            if kind is not None and not kind.accepts(value):
                raise InvalidInputError(_refusal(name, value, kinds, dict(given)))
        return function(*args, **options)

    return call


class _Kind(NamedTuple):
    """What an argument may be: in words that follow "must", and as a test."""

    words: str
    accepts: Callable[[Any], bool]


class _Signature(NamedTuple):
    positional: list[str]
    rest: str  # of ``*args``
    kinds: dict[str, _Kind]


class _Torch:
    """Stands for torch in annotations: it is imported only where something is computed with it."""

    Tensor = dtype = Any


_LATE = {"torch": _Torch, "Figure": Any}  # Matplotlib's, imported where something is drawn


def _signature(function: Callable[..., Any]) -> _Signature:
    parameters = inspect.signature(function).parameters.values()
    hints = typing.get_type_hints(function, localns=_LATE, include_extras=True)
    # NaN is no number to compute with, but a record may hold it, where there is nothing to tell.
    record = function.__name__ == "__init__"
    for p in parameters:
        if hints.get(p.name) is float and (record or p.default != p.default):
            hints[p.name] = _NUMBER_OR_NAN
    kinds = {p.name: _kind(hints.get(p.name, Any)) for p in parameters}
    return _Signature(
        [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD],
        next((p.name for p in parameters if p.kind is p.VAR_POSITIONAL), ""),
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
        return said and _Kind(said.words, lambda v: any(accepts(v) for accepts in accepted))
    if origin is Literal:
        return _Kind(
            f"be {_listed([repr(a) for a in args])}",
            lambda v: any(type(v) is type(a) and v == a for a in args),
        )
    base = hint if origin is None else origin
    if not isinstance(base, type) or base is object:
        return None
    if base is np.ndarray:
        return _numbers(_letters(typing.get_args(args[1])[0]), scalar=False)
    if origin is Callable:
        return _Kind("be a function", lambda v: callable(v) and not isinstance(v, type))
    if issubclass(base, tuple) and args:
        return _sequence(base, args)
    if issubclass(base, Mapping) and args:
        return _mapping(args)
    if issubclass(base, Sequence) and args:
        return _sequence(base, (*args, ...))
    if issubclass(base, sparse.sparray):
        return _Kind("be a scipy sparse array", sparse.issparse)
    if issubclass(base, os.PathLike):
        return _Kind("be a path", lambda v: isinstance(v, str | os.PathLike))
    return _Kind(
        f"be {_with_article(base.__name__)}",
        lambda v: isinstance(v, base) and not isinstance(v, type),
    )


def _is_integer(value: Any) -> bool:
    """Whether this is an integer that NumPy can hold."""
    return isinstance(value, np.integer) or (
        isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63
    )


def _is_number(value: Any) -> bool:
    return _is_integer(value) or isinstance(value, float | np.floating)


_NUMBER_OR_NAN = NewType("_NUMBER_OR_NAN", float)
_SCALARS = {
    Any: None,
    None: _Kind("be None", lambda v: v is None),
    type(None): _Kind("be None", lambda v: v is None),
    bool: _Kind("be True or False", lambda v: isinstance(v, bool | np.bool_)),
    int: _Kind("be an integer", _is_integer),
    float: _Kind("be a number", lambda v: _is_number(v) and v == v),
    _NUMBER_OR_NAN: _Kind("be a number", _is_number),
    str: _Kind("be a string", lambda v: isinstance(v, str)),
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
        except (ValueError, TypeError):  # rows of several lengths, a tensor on another device
            return False
        if array.ndim == 0 and not scalar:
            return False
        return array.dtype.kind in letters or (array.size == 0 and array.dtype.kind == "f")

    words = "integers" if "f" not in letters else "real numbers"
    return _Kind(f"hold {words}", accepts)


def _either(kinds: Sequence[_Kind | None]) -> _Kind | None:
    """Return the kind of what is one of several; what holds others is told apart inside."""
    some = [kind for kind in kinds if kind is not None]
    proper = [kind.words for kind in some if kind.words != "be None"]
    held = any(" of " in words or words.startswith("hold ") for words in proper)
    if len(some) < len(kinds) or (held and len(proper) > 1):
        return None
    first, *others = (kind.words for kind in some)
    plain = [re.sub("^be (an? )?", "", words) for words in others]
    alternatives = [*first.replace(" or ", ", ").split(", "), *plain]
    return _Kind(_listed(alternatives), lambda v: any(kind.accepts(v) for kind in some))


def _sequence(base: type, args: tuple[Any, ...]) -> _Kind:
    several = args[-1] is ...
    kinds = [_kind(a) for a in args if a is not ...]

    def accepts(value: Any) -> bool:
        if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
            return False
        if not several and len(value) != len(kinds):
            return False
        each = repeat(kinds[0]) if several else kinds
        return all(k is None or k.accepts(v) for k, v in zip(each, value, strict=False))

    size = "" if several else f"{len(kinds)} "
    return _Kind(f"be a {base.__name__.lower()} of {size}{_plural(kinds[0])}", accepts)


def _mapping(args: tuple[Any, ...]) -> _Kind:
    key, item = map(_kind, args)

    def accepts(value: Any) -> bool:
        return isinstance(value, Mapping) and all(
            (key is None or key.accepts(k)) and (item is None or item.accepts(v))
            for k, v in value.items()
        )

    return _Kind(f"be a mapping of {_plural(key)} to {_plural(item)}", accepts)


def _plural(kind: _Kind | None) -> str:
    if kind is None:
        return "values"
    noun = re.sub("^be an? ", "", kind.words)
    return f"{noun}s" if noun != kind.words else kind.words.replace("hold", "arrays of")


_ADVICE = {
    "Laplacian": "; build one with robust_laplacian(geometry)",
    "Spectrum": "; solve for one: eigensolve(robust_laplacian(mesh), 50)",
    "TriangleMesh or PointCloud": "; wrap bare arrays in one of them",
    "Eigensolver": ", which has no method eigenpairs(laplacian, k); pass one such as Arpack()",
    "Subspace": ", which is no function of points and mass; pass one such as"
    " AmbientFourier() or Neo().subspace, or wrap columns that you have in GivenBasis(columns)",
    "Truth": "; where a point map is the truth, Truth.of_map(point_map)",
    "MapErrors": ", which does not say at which points they are; pass map_errors(source, point_map,"
    " truth), or MapErrors(errors, points)",
    "integers": "; count from 0",
}


def _refusal(name: str, value: Any, kinds: Mapping[str, _Kind], given: Mapping[str, Any]) -> str:
    """Say what the argument must be, what arrived, and what to do."""
    kind = kinds[name]
    if kind.words.startswith("hold ") and isinstance(value, list | tuple):
        try:
            np.asarray(value)
        except ValueError as error:
            return f"`{name}` must have rows of one length ({error})"
    said = f"`{name}` must {kind.words}, got {_described(value, kind)}"
    for other in kinds.keys() & given.keys() - {name}:
        if kinds[other].accepts(value) and kind.accepts(given[other]):
            return f"{said}; did you swap it with `{other}`?"
    if isinstance(value, type):
        return f"{said}; pass an instance of it"
    if isinstance(value, int) and abs(value) > 2**62:
        return f"{said}, which takes more than 64 bits"
    return said + next((text for word, text in _ADVICE.items() if word in kind.words), "")


def _described(value: Any, kind: _Kind) -> str:
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if value is None or isinstance(value, bool | int | float | complex | str | np.generic):
        return repr(value) if len(repr(value)) < 60 else f"a long {type(value).__name__}"
    if kind.words.startswith("hold ") and isinstance(value, np.ndarray | list | tuple):
        return f"dtype {np.asarray(value).dtype}"
    if " of " in kind.words and isinstance(value, Sequence | Mapping) and len(repr(value)) < 60:
        return repr(value)
    return _with_article(type(value).__name__)


def _with_article(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def _listed(words: Sequence[str]) -> str:
    """Return words as a list that ends in "or"."""
    return " or ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
