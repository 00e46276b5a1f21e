"""Compiler from jaxprs to WebAssembly: it evaluates constant expressions and keeps small arrays in local variables.

Bodies of loops become separate functions, so that browsers can optimise them while a loop runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from fitting.cli.twin.arrays import SMALL, Arrays, Stored, Value, array, kind_of_table, known, operand, stride
from fitting.cli.twin.primitives import ELEMENTWISE, FOLDED, JOINED, MOVED, REDUCED, RUNNING
from fitting.cli.twin.wasm import F64, I32, SLOT, Code, Operand
from pftwin.base.errors import InputError

_CALLED = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # parameters of primitives that only call another jaxpr


class Emitter(Arrays):
    """Compiles programs into a module."""

    def program(self, name: str, function: Callable[..., Any], *examples: Any) -> dict[str, Any]:
        """Compiles a traceable function of arrays like the examples, and exports it under a name.

        Returns "inputs" and "outputs": [address, size, 1 for float64 or 0 for integers] of every array. Raises
        InputError for a primitive or a type of number that is not supported.
        """
        made, shape = jax.make_jaxpr(function, return_shape=True)(*examples)
        code = Code()
        inputs = [self.reserve(jnp.asarray(leaf)) for leaf in jax.tree.leaves(examples)]
        found = self.run(code, made.jaxpr, made.consts, [self.fetched(code, t) for t in inputs])
        outputs = [self.reserve(leaf) for leaf in jax.tree.leaves(shape)]
        self.store_all(code, outputs, found)
        self.module.function(code, name)
        return {
            "inputs": list(map(_place, inputs)),
            "outputs": jax.tree.unflatten(jax.tree.structure(shape), list(map(_place, outputs))),
        }

    def run(self, code: Code, jaxpr: Any, consts: Sequence[Any], args: Sequence[Value]) -> list[Value]:
        """Compiles a jaxpr for these arguments; returns its results."""
        held: dict[Any, Value] = dict(zip(jaxpr.invars, args, strict=True))
        held |= {v: np.asarray(c) for v, c in zip(jaxpr.constvars, consts, strict=True)}

        def read(atom: Any) -> Value:
            aval: Any = atom.aval
            return np.asarray(atom.val, aval.dtype) if isinstance(atom, Literal) else held[atom]

        for eqn in _used(jaxpr):
            found = self._equation(code, eqn, [read(a) for a in eqn.invars])
            held |= dict(zip(eqn.outvars, found, strict=True))
        return [read(a) for a in jaxpr.outvars]

    def _equation(self, code: Code, eqn: Any, args: list[Value]) -> Sequence[Value]:
        name, params = eqn.primitive.name, eqn.params
        inner = next((params[k] for k in _CALLED if k in params), None)
        if (
            inner is not None
            and not (name == "jit" and all(map(known, args)))
            and name not in ("while", "scan", "cond")
        ):
            closed = hasattr(inner, "consts")
            return self.run(code, inner.jaxpr if closed else inner, inner.consts if closed else (), args)
        if all(map(known, args)):
            if name in FOLDED or name in MOVED or name in JOINED:  # by numpy: JAX would compile it first
                return [np.asarray(_folded(name, params, args), eqn.outvars[0].aval.dtype)]
            found = eqn.primitive.bind(*map(jnp.asarray, args), **params)
            return [np.asarray(x) for x in (found if eqn.primitive.multiple_results else [found])]
        out: Any = eqn.outvars[0].aval if eqn.outvars else None
        if name == "while":
            return self._while(code, params, args)
        if name == "scan":
            return self._scan(code, params, args)
        if name in ELEMENTWISE:
            return [self.elementwise(code, ELEMENTWISE[name], self._typed(name, eqn), args, out)]
        if name in MOVED:
            return [self.moved(code, lambda x: MOVED[name](params, x), args, out)]
        if name in JOINED:
            return [self.joined(code, lambda x: JOINED[name](params, x), args, out)]
        if name in REDUCED:
            return [self.reduced(code, ELEMENTWISE[REDUCED[name]], params["axes"], args[0], out)]
        if name in RUNNING and len(out.shape) == 1 and not params["reverse"]:
            return [self.running(code, ELEMENTWISE[RUNNING[name]], args[0], out)]
        if name == "dynamic_slice":
            return [self._dynamic_slice(code, args, out)]
        raise InputError(
            f"the scene's program contains the operation {name!r}",
            where="twin",
            expected="arithmetic, loops and slices, as in contacts on polynomial surfaces",
            remedy="--contact P5 with a scene file or --case; pftwin app supports further contacts",
        )

    def _typed(self, name: str, eqn: Any) -> dict[str, Any]:
        return {**eqn.params, "dtype": eqn.invars[0].aval.dtype} if name == "not" else eqn.params

    def _while(self, code: Code, params: Any, args: list[Value]) -> list[Value]:
        split = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        parts = args[: split[0]], args[split[0] : split[1]], args[split[1] :]
        held = [[self.stored(code, a) for a in part] for part in parts[:2]]
        carry = [self.reserve(v.aval) for v in params["body_jaxpr"].jaxpr.outvars]
        answer = self.reserve(jax.ShapeDtypeStruct((), bool))
        self.store_all(code, carry, parts[2])

        def function(closed: ClosedJaxpr, consts: list[Value], to: list[Stored]) -> int:
            inner = Code()
            values = [self.fetched(inner, x) for x in (*consts, *carry)]
            self.store_all(inner, to, self.run(inner, closed.jaxpr, closed.consts, values))
            return self.module.function(inner)

        condition = function(params["cond_jaxpr"], held[0], [answer])
        code.repeat_while(condition, answer.address, function(params["body_jaxpr"], held[1], carry))
        return [self.fetched(code, t) for t in carry]

    def _scan(self, code: Code, params: Any, args: list[Value]) -> list[Value]:
        n, m, closed = params["num_consts"], params["num_consts"] + params["num_carry"], params["jaxpr"]
        consts = [self.stored(code, a) for a in args[:n]]
        carry = [self.reserve(v.aval) for v in closed.jaxpr.outvars[: m - n]]
        self.store_all(code, carry, args[n:m])
        rows = [self.table(code, a) for a in args[m:]]
        length = params["length"]
        after = [jax.ShapeDtypeStruct((length, *v.aval.shape), v.aval.dtype) for v in closed.jaxpr.outvars[m - n :]]
        made = [self.reserve(a) for a in after]
        inner = Code(counted=True)
        i = inner.op(b"\x6b", I32, length - 1, inner.count) if params["reverse"] else inner.count
        values = [self.fetched(inner, t) for t in (*consts, *carry)]
        values += [self._row(inner, t, i) for t in rows]
        found = self.run(inner, closed.jaxpr, closed.consts, values)
        self.store_all(inner, carry, found[: m - n])
        for table, row in zip(made, found[m - n :], strict=True):
            at = inner.op(b"\x6c", I32, i, int(np.prod(table.shape[1:])) * SLOT)
            for k, x in enumerate(self.entries(inner, row).reshape(-1)):
                inner.store(operand(x), table.address + SLOT * k, at)
        function = self.module.function(inner)
        with code.loop(length) as j:
            code.call(function, j)
        return [self.fetched(code, t) for t in carry] + [self.fetched(code, t) for t in made]

    def _row(self, code: Code, table: Stored, i: Operand) -> Value:
        size = int(np.prod(table.shape[1:]))
        if size > SMALL:
            raise InputError(f"rows of {size} numbers", where="twin", expected=f"at most {SMALL}")
        at = code.op(b"\x6c", I32, i, size * SLOT)
        loads = [code.load(kind_of_table(table), table.address + SLOT * k, at) for k in range(size)]
        return array(loads, table.shape[1:])

    def _dynamic_slice(self, code: Code, args: list[Value], out: Any) -> Value:
        source = self.table(code, args[0])
        places = np.arange(np.prod(source.shape)).reshape(source.shape)
        at: Operand = 0
        for axis, start in enumerate(args[1:]):
            most = source.shape[axis] - out.shape[axis]
            inside = ELEMENTWISE["clamp"](code, {}, 0, self.single(code, start), most)
            ahead = code.op(b"\x6c", I32, inside, stride(places, axis) * SLOT)
            at = code.op(b"\x6a", I32, at, ahead)
        taken = places[tuple(slice(0, n) for n in out.shape)].reshape(-1)
        if taken.size > SMALL:
            raise InputError(f"a slice of {taken.size} numbers", where="twin", expected=f"at most {SMALL}")
        return array([code.load(kind_of_table(source), source.address + SLOT * int(t), at) for t in taken], out.shape)


def _folded(name: str, params: Any, args: list[Any]) -> Any:
    if name in FOLDED:
        return FOLDED[name](*args)
    return MOVED[name](params, args[0]) if name in MOVED else JOINED[name](params, args)


def _used(jaxpr: Any) -> list[Any]:
    """The equations that the results depend on."""
    wanted, needed = {v for v in jaxpr.outvars if not isinstance(v, Literal)}, []
    for eqn in reversed(jaxpr.eqns):
        if wanted.intersection(eqn.outvars):
            needed.append(eqn)
            wanted |= {v for v in eqn.invars if not isinstance(v, Literal)}
    return needed[::-1]


def _place(table: Stored) -> list[Any]:
    return [table.address, int(np.prod(table.shape)), int(kind_of_table(table) == F64)]
