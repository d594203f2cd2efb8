"""The state of objects as named arrays and JSON values, for checkpoints without pickles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]


def pack(value: Any, name: str, arrays: Arrays) -> Any:
    """Return `value` as JSON; its arrays are copied to `arrays`, where their keys begin with `name`.

    Every mapping in the result has one key, which names a type that JSON does not have.

    Args:
        value: numbers, strings, None, arrays of numbers, NumPy generators, and lists, tuples and dictionaries
            of them.

    Raises:
        TypeError: the value has a different type.
    """
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind not in "biuf" or value.dtype.itemsize > 8:
            raise TypeError(f"'{name}' is an array of {value.dtype}")
        while name in arrays:  # for example a key with a dot, or both 1 and "1" as keys
            name += "'"
        arrays[name] = np.array(value)
        return {"array" if isinstance(value, np.ndarray) else "scalar": name}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.random.Generator):
        bits = value.bit_generator
        return {"generator": [type(bits).__name__, pack(bits.state, name, arrays)]}
    if isinstance(value, list | tuple):
        items = [pack(item, f"{name}.{i}", arrays) for i, item in enumerate(value)]
        return items if isinstance(value, list) else {"tuple": items}
    if isinstance(value, dict):
        return {"dict": [[pack(k, name, arrays), pack(v, f"{name}.{k}", arrays)] for k, v in value.items()]}
    raise TypeError(f"'{name}' is a {type(value).__name__}")


def unpack(value: Any, arrays: Arrays) -> Any:
    """Return what `pack` was given; arrays are copies.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: `pack` did not return these.
    """
    if isinstance(value, list):
        return [unpack(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    if kind == "array":
        return arrays[content].copy()
    if kind == "scalar":
        return arrays[content][()]
    items = unpack(content, arrays)
    if kind == "tuple":
        return tuple(items)
    if kind == "dict":
        return dict(items)
    name, state = items
    if kind != "generator" or name not in BIT_GENERATORS:
        raise ValueError(f"unknown type '{kind}' or generator '{name}'")
    bits = BIT_GENERATORS[name]()
    bits.state = state
    return np.random.Generator(bits)


BIT_GENERATORS: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937, np.random.Philox, np.random.SFC64)
}
