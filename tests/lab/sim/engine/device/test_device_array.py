"""`DeviceArray` and `EnvMask` against numpy on the same numbers, on a GPU or else the CPU.

Every entry of the tables of `device_functions` is tried: one without an example fails.
"""

import inspect

import numpy as np
import pytest
import torch

from embodichain.lab.sim.engine.device import device_values
from embodichain.lab.sim.engine.device.device_array import (
    DeviceArray,
    EnvMask,
    HostTransferError,
    constant,
    on_device,
)
from embodichain.lab.sim.engine.device.device_functions import BINARY, FUNCTIONS, REDUCTIONS, UNARY
from embodichain.lab.sim.engine.warp.device_arrays import DeviceArrays

DEVICE = torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
rng = np.random.default_rng(0)
X = rng.uniform(0.1, 0.9, (3, 4, 3)).astype(np.float32)
"""In the domain of every function."""
Y = rng.uniform(-2, 2, (4, 3)).astype(np.float32)
WILD = np.array([[np.nan, np.inf, -np.inf], [-1.5, 0.0, 2.5]], np.float32)
FLAGS = X > 0.5
COUNTS = rng.integers(0, 5, X.shape)


def on(array):
    return on_device(array, DEVICE)


def same(found, wanted, *, exact=False):
    """The same numbers, shape and type, where float64 is float32 on a device."""
    wanted = np.asarray(wanted)
    kept = np.float32 if wanted.dtype == np.float64 else wanted.dtype
    assert type(found) is DeviceArray
    assert (found.shape, found.dtype) == (wanted.shape, kept)
    np.testing.assert_allclose(
        found.host(), wanted, rtol=0 if exact else 2e-6, atol=0 if exact else 2e-7
    )


def moved(value):
    """The same arguments, with arrays on the device."""
    if isinstance(value, np.ndarray):
        return on(value)
    if isinstance(value, list):
        return [moved(part) for part in value]
    return value


OF_WHOLE_NUMBERS = {np.invert, np.bitwise_and, np.bitwise_or, np.bitwise_xor}
OF_FLAGS = {np.logical_and, np.logical_or, np.logical_not}


@pytest.mark.parametrize("function", UNARY, ids=lambda f: f.__name__)
def test_functions_of_one_array(function):
    if function in OF_WHOLE_NUMBERS:
        same(function(on(COUNTS)), function(COUNTS))
        same(function(on(FLAGS)), function(FLAGS))
    elif function in OF_FLAGS:
        same(function(on(FLAGS)), function(FLAGS))
    else:
        same(function(on(X)), function(X))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            same(function(on(WILD)), function(WILD))


@pytest.mark.parametrize("function", BINARY, ids=lambda f: f.__name__)
def test_functions_of_two_arrays(function):
    whole = function in OF_WHOLE_NUMBERS
    a, b = (COUNTS, COUNTS[0] + 1) if whole else (FLAGS, X) if function in OF_FLAGS else (X, Y)
    if function is np.power:
        a, b = b, np.float32([2.0, 3.0, 2.0])
    same(function(on(a), on(b)), function(a, b))
    same(function(on(a), b), function(a, b))  # a constant of the host
    same(function(a, on(b)), function(a, b))
    number = b[(0,) * b.ndim].item()
    if function is not np.vecdot:
        same(function(on(a), number), function(a, number))
        same(function(number, on(np.abs(b))), function(number, np.abs(b)))


@pytest.mark.parametrize("axis", [0, -1, (0, 2), None])
@pytest.mark.parametrize("keepdims", [False, True])
@pytest.mark.parametrize("function", REDUCTIONS, ids=lambda f: f.__name__)
def test_reductions(function, axis, keepdims):
    values = FLAGS if function in OF_FLAGS else X
    wanted = function.reduce(values, axis=axis, keepdims=keepdims)
    same(function.reduce(on(values), axis=axis, keepdims=keepdims), wanted)


EDGES = np.sort(X[0].ravel())
INDICES = np.argsort(X, axis=1)
FUNCTION_EXAMPLES = {
    np.all: [((FLAGS,), {}), ((FLAGS, 1), {}), ((FLAGS,), {"axis": (0, 1), "keepdims": True})],
    np.amax: [((X,), {}), ((X, -1), {}), ((COUNTS,), {"axis": (0, 1)})],
    np.amin: [((X,), {}), ((X, -1), {}), ((COUNTS,), {"axis": (0, 1)})],
    np.any: [((FLAGS,), {}), ((FLAGS, 1), {}), ((FLAGS,), {"axis": (0, 1), "keepdims": True})],
    np.argsort: [((X,), {}), ((X, 1), {}), ((COUNTS,), {"axis": 0, "kind": "stable"})],
    np.broadcast_to: [((Y, (2, 4, 3)), {})],
    np.clip: [((X, 0.3, 0.6), {}), ((X, Y, None), {}), ((X, None, Y), {})],
    np.concatenate: [(([X, COUNTS],), {}), (([X, X], -1), {}), (([X, Y],), {"axis": None})],
    np.cross: [((X, Y), {}), ((X, Y[0]), {}), ((X.T, X.T), {"axis": 0})],
    np.empty_like: [],  # any numbers
    np.expand_dims: [((X, 1), {})],
    np.full_like: [((X, 2.5), {}), ((COUNTS, 7), {}), ((X, True, np.bool_), {}), ((X, Y), {})],
    np.linalg.norm: [((X,), {}), ((X,), {"axis": -1}), ((X, None, 1, True), {})],
    np.mean: [((X,), {}), ((X, -1), {}), ((FLAGS,), {"axis": 0}), ((COUNTS,), {"axis": (0, 1)})],
    np.moveaxis: [((X, 0, -1), {}), ((X, [0, 1], [1, 2]), {})],
    np.ones_like: [((X,), {}), ((X, np.bool_), {})],
    np.repeat: [((X, 2), {"axis": 1}), ((X, 3), {})],
    np.reshape: [((X, (4, -1)), {}), ((X, -1), {})],
    np.searchsorted: [((EDGES, X), {}), ((EDGES, X), {"side": "right"})],
    np.stack: [(([X, COUNTS],), {}), (([X, X], -1), {})],
    np.sum: [((X,), {}), ((X, -1), {}), ((FLAGS,), {"axis": (0, 1), "keepdims": True})],
    np.swapaxes: [((X, 0, 2), {})],
    np.take_along_axis: [((X, INDICES), {"axis": 1})],
    np.tile: [((Y, 2), {}), ((Y, (2, 1, 3)), {})],
    np.where: [
        *[((FLAGS, a, b), {}) for a, b in ((X, Y), (X, 0.0), (1, COUNTS), (0.5, 2), (1, 2))],
        ((FLAGS, FLAGS, 3), {}),
        ((FLAGS, True, False), {}),
    ],
    np.zeros_like: [((COUNTS,), {}), ((X, np.int64), {}), ((X,), {"shape": (2, 3)})],
}


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_functions_of_arrays(function):
    for args, options in FUNCTION_EXAMPLES[function]:
        same(function(*map(moved, args), **options), function(*args, **options))
    if function is np.empty_like:
        assert np.empty_like(on(X), np.int64).dtype == np.int64


METHODS = {
    "copy": ((),),
    "astype": ((np.int64,), (np.float64,), (np.bool_,)),
    "reshape": ((4, 9), ((-1, 3),)),
    "take": (([1, 0, 1], 2), (np.array([[0, -1]]), 1), (1, 0)),
    "swapaxes": ((0, 2),),
    "any": ((1,),),
    "all": ((1,),),
    "sum": ((), (1,)),
    "mean": ((), ((0, 2),)),
    "min": ((), (1,)),
    "max": ((), (1,)),
    "argmin": ((1,),),
    "argmax": ((2,),),
}


@pytest.mark.parametrize("name", METHODS)
def test_methods(name):
    values = FLAGS if name in ("any", "all") else X - 0.5
    for args in METHODS[name]:
        same(getattr(on(values), name)(*args), getattr(values, name)(*args))


def test_shapes_and_types():
    array = on(X)
    assert (len(array), array.ndim, array.size, array.T.shape) == (3, 3, 36, (3, 4, 3))
    assert [part.shape for part in array] == [(4, 3)] * 3
    assert repr(array) == f"DeviceArray((3, 4, 3), float32, {DEVICE})"
    for kind in (np.float64, np.int64, np.int32, np.uint8, np.bool_):
        same(on(COUNTS.astype(kind)), COUNTS.astype(kind))
    copy = array.copy()
    copy[...] = 0.0
    same(array, X)
    for dtype in (np.int16, np.complex128):
        with pytest.raises(HostTransferError, match=f"numbers of type {np.dtype(dtype)}"):
            on(COUNTS.astype(dtype))


PLACES = np.array([2, 0])
KEYS = {
    "a row": 1,
    "columns": (slice(None), slice(1, 3)),
    "the last": (Ellipsis, -1),
    "new axes": (slice(None), None, 0),
    "indices": PLACES,
    "a list": (slice(None), [3, 1, 1]),
    "indices of two axes": (PLACES[:, None], np.array([[1, 2, 3]])),
    "small indices": PLACES.astype(np.uint8),
    "a mask of the host": (slice(None), np.array([True, False, True, True])),
    "numpy's number": np.int64(2),
}
REVERSED = {
    "reversed": (Ellipsis, slice(None, None, -1)),
    "reversed in part": (0, slice(3, 0, -2)),
    "reversed, with a new axis": (None, slice(None, None, -1), slice(1, None)),
    "reversed, with indices": (slice(None, None, -1), PLACES),
    "nothing, reversed": (slice(0, 2, -1),),
}


@pytest.mark.parametrize("key", KEYS | REVERSED)
def test_reads(key):
    same(on(X)[(KEYS | REVERSED)[key]], X[(KEYS | REVERSED)[key]], exact=True)


def test_indices_of_the_device():
    same(on(X)[:, on(PLACES)], X[:, PLACES], exact=True)
    same(on(X).take(on(PLACES), 1), X.take(PLACES, 1), exact=True)


@pytest.mark.parametrize("key", KEYS)
def test_writes(key):
    for value in (7.5, Y[0, 0], COUNTS[KEYS[key]], on(COUNTS[KEYS[key]])):
        array, wanted = on(X), X.copy()
        array[KEYS[key]] = value
        wanted[KEYS[key]] = value.host() if isinstance(value, DeviceArray) else value
        same(array, wanted, exact=True)


def test_overlapping_writes():
    for into, source in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
        array, wanted = on(X), X.copy()
        array[:, into] = array[:, source]
        wanted[:, into] = wanted[:, source]
        same(array, wanted, exact=True)


def test_operators_in_place():
    array, wanted = on(X), X.copy()
    view, tensor = array[0], array.tensor
    array += 1
    array *= on(Y)
    array -= Y
    array /= 2
    wanted = (((wanted + 1) * Y) - Y) / 2
    assert array.tensor is tensor
    same(array, wanted)
    same(view, wanted[0])
    flags, other = on(FLAGS), on(X > 0.7)
    flags |= other
    flags &= ~other
    same(flags, (FLAGS | (X > 0.7)) & ~(X > 0.7))
    counts = on(COUNTS)
    with pytest.raises(TypeError, match=r"cannot write torch\.float32 into an array of torch\.int"):
        counts += 0.5


def test_results_written_into_arrays():
    out = on(X)
    assert np.multiply(on(X), 2, out=out) is out
    same(out, X * 2)
    wanted = np.divide(Y, 3, out=Y.copy(), where=Y > 0)
    same(np.divide(on(Y), 3, out=on(Y), where=on(Y > 0)), wanted)


# -- masks of environments -------------------------------------------------------------------------

CHOSEN = np.array([True, False, True])


def test_a_mask_reads_all_rows_and_writes_its_own():
    ids, mask = np.flatnonzero(CHOSEN), EnvMask(torch.from_numpy(CHOSEN).to(DEVICE))
    assert len(mask) == 3
    array, wanted = on(X), X.copy()
    same(array[mask], X, exact=True)
    same(array[mask[:, None], [2, 0]], X[:, [2, 0]], exact=True)
    array[mask] = array[mask] * 2
    wanted[ids] = wanted[ids] * 2
    rows = array[mask]
    rows += 3.0  # a copy, as from numpy's indices
    array[mask, 1] = -1.0
    wanted[ids, 1] = -1.0
    array[mask[:, None], [3, 2], :2] = on(Y[:3, None, :2])
    wanted[ids[:, None], [3, 2], :2] = Y[ids, None, :2]
    array[mask[on(np.array([True, True, False]))]] += 1.0
    wanted[0] += 1.0
    same(array, wanted)
    array[on(CHOSEN)] = 0.0
    wanted[CHOSEN] = 0.0
    turned = array.T  # environments are its last axis
    turned[:, 1, mask] = 5.0
    wanted[ids, 1] = 5.0
    same(array, wanted)


def test_environments_of_masks():
    arrays = DeviceArrays(str(DEVICE))
    some = arrays.where(on(CHOSEN))
    assert some.mask.tolist() == CHOSEN.tolist() and not arrays.are_all(some, 3)
    assert arrays.environments(np.array([0, 2]), 3).mask.tolist() == CHOSEN.tolist()
    every = arrays.every(3)
    assert arrays.are_all(every, 3) and every.mask.all()


# -- what is refused -------------------------------------------------------------------------------

REFUSED = {
    "array": (lambda x: np.asarray(x), "made one of the host"),
    "branch": (lambda x: 1 if x[0, 0, 0] > 0 else 2, "decided a branch"),
    "float": (lambda x: float(x[0, 0, 0]), "made a Python number"),
    "int": (lambda x: int(x[0, 0, 0]), "made a Python number"),
    "item": (lambda x: x.item(), "made a Python number"),
    "range": (lambda x: range(on(COUNTS)[0, 0, 0]), "made a Python number"),
    "bytes": (lambda x: x.tobytes(), "made bytes"),
    "list": (lambda x: x.tolist(), "made a list"),
    "in": (lambda x: 3.0 in x[0, 0], "decided a branch"),
    "mask": (lambda x: x[x > 0.5], "selected by a mask"),
    "mask of two axes": (lambda x: x[np.ones((3, 4), np.bool_)], r"a mask of the host .* index"),
    "host array": (lambda x: X.copy().__setitem__(0, x[0]), "made one of the host"),
    "into the host": (lambda x: np.add(x, 1, out=X.copy()), "into an array of the host"),
    "in place": (lambda x: X.copy().__iadd__(x), "into an array of the host"),
    "data": (lambda x: x[:, None, 0] + np.zeros((1, 20000)), r"host of shape \(1, 20000\)"),
    "type": (lambda x: x + X.astype(np.complex64), "numbers of type complex64"),
    "method": (lambda x: x.cumsum(), "the method cumsum"),
    "function": (lambda x: np.median(x), r"numpy\.median is not available"),
    "argument": (lambda x: np.sum(x, where=x > 0), r"numpy\.sum with these arguments"),
    "norm": (lambda x: np.linalg.norm(x, 1, 0), r"numpy\.linalg\.norm with ord"),
    "where": (lambda x: np.add(x, 1, where=x > 0), r"numpy\.add with where and without out"),
    "ufunc": (lambda x: np.logaddexp(x, x), r"numpy\.logaddexp \(__call__\) is not available"),
    "outer": (lambda x: np.add.outer(x, x), r"numpy\.add \(outer\) is not available"),
    "option": (lambda x: np.add(x, 1, dtype=np.float64), r"options \['dtype'\] of numpy\.add"),
    "positions": (lambda x: EnvMask(on(CHOSEN).tensor)[0], "selected by position"),
    "mask of indices": (lambda x: np.asarray(EnvMask(x.tensor)), "made an array of the host"),
    "rows of the host": (lambda x: X[EnvMask(on(CHOSEN).tensor)], "made an array of the host"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_transfers_are_refused_with_their_line(what):
    call, message = REFUSED[what]
    line = inspect.getsourcelines(call)[1]
    with pytest.raises(HostTransferError, match=f"{message}.* at .*{__name__.split('.')[-1]}") as e:
        call(on(X))
    assert f"test_device_array.py:{line}: " in str(e.value)
    assert "use sim.warp.arrays=host" in str(e.value)


def test_it_has_no_other_attributes():
    with pytest.raises(AttributeError, match="a DeviceArray has no attribute 'uid'"):
        on(X).uid  # noqa: B018
    assert not hasattr(on(X), "__array_interface__")


# -- constants -------------------------------------------------------------------------------------


def test_constants_are_copied_once_and_the_oldest_forgotten(monkeypatch):
    # Thousands of constants would be needed otherwise.
    monkeypatch.setattr(device_values, "_MOST_CONSTANTS", 2)
    known = device_values.Constants()
    first = known.get(Y, DEVICE)
    assert known.get(Y.copy(), DEVICE) is first
    second = known.get(Y[0], DEVICE)
    assert known.get(Y, DEVICE) is first
    known.get(Y[1], DEVICE)
    assert known.get(Y, DEVICE) is first and known.get(Y[0], DEVICE) is not second
    assert known.get(Y[0].astype(np.int64), DEVICE).dtype == torch.int64
    large = np.zeros((1, 20000))  # refused in expressions, see above
    assert constant(large, DEVICE).tensor is constant(large.copy(), DEVICE).tensor


def test_a_captured_step_keeps_its_constants_and_makes_none(monkeypatch):
    # Thousands of constants would be needed otherwise; and a capture needs CUDA.
    monkeypatch.setattr(device_values, "_MOST_CONSTANTS", 1)
    known = device_values.Constants()
    first = known.get(Y, DEVICE)
    monkeypatch.setattr(device_values, "_capturing", lambda: True)
    assert known.get(Y, DEVICE) is first
    with pytest.raises(HostTransferError, match=r"shape \(3,\) is new in a captured step"):
        known.get(Y[0], DEVICE)
    monkeypatch.setattr(device_values, "_capturing", lambda: False)
    known.get(Y[0], DEVICE)
    known.get(Y[1], DEVICE)
    assert known.get(Y, DEVICE) is first
