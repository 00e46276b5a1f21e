"""Channels that can be measured of a motion, and compiled programs that predict them for many parameter vectors.

The programs only predict. Measurements are compared on the host (`fitting.objective`), so that one program serves every
objective, method and phase of a fit. The number of steps between two frames is a variable of the program, not part of
it. Variants are sharded over several devices.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.parameters import applied
from pftwin.base.errors import InputError
from pftwin.base.program_cache import Program
from pftwin.base.spatial import Pose, Scalar
from pftwin.dynamics.batch.batched import AXIS, SPLIT, batched, shard_over
from pftwin.dynamics.frame_states import scan_observations, starting_equilibrium
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import instant_and_frame
from pftwin.dynamics.state import Guide, State, System
from pftwin.model.number_place import NumberPlace
from pftwin.model.scene import Scene
from pftwin.model.scene_parameters import numbered_elements

POSITION, ORIENTATION = "position", "orientation"
TURNS = ("tilt", "flexion", "rotation")  # small rotations about the patella's axes x, y, z: to first order these angles


def channels_of(scene: Scene) -> tuple[str, ...]:
    """Standard channels of a scene: poses, and forces of contact, tendons and ligaments. Any other observable of an
    effect is a channel too: "EFFECT.OBSERVABLE"."""
    contact = scene.contact
    tensions = [element.name for element in numbered_elements(scene)]
    return (POSITION, ORIENTATION, *([] if contact is None else [contact.name]), *tensions)


def with_readings(scene: Scene) -> tuple[str, ...]:
    """All channels of a scene, including every observable of its effects."""
    return (*channels_of(scene), *(f"{e.name}.{key}" for e in scene.effects for key in type(e).observables))


def unit_of(channel: str, readings: Mapping[str, str]) -> str:
    """Unit of a channel; `readings` holds the units of channels that are neither poses nor forces."""
    return readings.get(channel) or {POSITION: "m", ORIENTATION: "rad"}.get(channel, "N")


def reading_units(scene: Scene, channels: Iterable[str]) -> dict[str, str]:
    """Units of those channels that are readings, "EFFECT.OBSERVABLE". Raises InputError if no effect of the scene
    reports one."""
    known = channels_of(scene)
    return {channel: scene.reported(channel).unit for channel in channels if channel not in known}


def channel_widths(channels: tuple[str, ...]) -> tuple[int, ...]:
    """Columns of each channel: position 3, orientation 4 (a unit quaternion), forces 1."""
    return tuple({POSITION: 3, ORIENTATION: 4}.get(c, 1) for c in channels)


def side_by_side(channels: tuple[str, ...]) -> list[tuple[str, slice]]:
    """Each channel with its columns in the predictions."""
    widths = channel_widths(channels)
    ends = np.cumsum(widths).tolist()
    return [(c, slice(end - n, end)) for c, n, end in zip(channels, widths, ends, strict=True)]


def columns_of(channels: tuple[str, ...], among: tuple[str, ...]) -> NDArray[np.intp]:
    """Indices of some channels' columns within those of a larger set."""
    columns = dict(side_by_side(among))
    return np.concatenate([np.r_[columns[c]] for c in channels])


_COLUMNS = PartitionSpec(None, AXIS)


def _sharded(
    mesh: Mesh | None, function: Callable[..., Any], shared: Any, each: tuple[Any, ...], out: Any = SPLIT
) -> Any:
    """function(shared, *each), sharded over the mesh's devices; None: JAX's default device."""
    return function(shared, *each) if mesh is None else shard_over(mesh, function, shared, each, out)


def _predicted(
    scene: Scene, guess: Pose, substeps: int | Scalar, channels: tuple[str, ...]
) -> tuple[Array, Pose, Array]:
    """Channels over the frames (n, c); the patella's pose at the start; whether that is an equilibrium."""
    start = starting_equilibrium(scene, guess)
    motion, effects = scene.motion, System.of(scene).effects
    forces = channels_of(scene)
    wanted = {c: (c, "") if c in forces else scene.reported(c)[:2] for c in channels}
    guides = Guide.sample(motion, motion.frame_times())

    def columns(state: State, _: Ledger | None, index: Scalar) -> Array:
        now, patella, center = instant_and_frame(scene, state, jax.tree.map(lambda a: a[index], guides))
        turn = patella.orientation
        found: list[Scalar] = []
        for channel in channels:
            if channel == POSITION:
                found += [center.x, center.y, center.z]
            elif channel == ORIENTATION:
                found += [turn.w, turn.x, turn.y, turn.z]
            else:
                owner, key = wanted[channel]
                k = next(i for i, e in enumerate(effects) if e.name == owner)
                report = effects[k].report(now, state.memories[k])[0]
                found.append(_number(report[key or ("force" if "force" in report else "tension")], channel))
        return jnp.stack(found)

    values = scan_observations(scene, columns, substeps=substeps, start=start)[0]
    pose = Pose(start.pose.apply(-scene.patella.center_of_mass), start.pose.orientation)
    return values, pose, start.converged()


def _number(value: Array, channel: str) -> Scalar:
    """A reported value that is one number per frame. Raises InputError if there are several."""
    if jnp.ndim(value):
        expected = "one number a frame, as a measurement has"
        raise InputError(f"{channel} has {jnp.size(value)} numbers a frame", where="use", expected=expected)
    return value


class FitProgram(NamedTuple):
    """The static part of a compiled program: what it computes, and on which devices."""

    places: tuple[NumberPlace, ...]  # of the parameters, in their order
    channels: tuple[str, ...]  # predicted channels
    mesh: Mesh | None  # devices over which the variants are sharded; None: JAX's default device

    def predicted(self, scene: Scene, theta: Array, guess: Pose, substeps: int | Scalar) -> tuple[Array, Pose, Array]:
        """The prediction of one variant."""
        return _predicted(applied(self.places, scene, theta), guess, substeps, self.channels)


@Program
def predictions(program: FitProgram, scene: Scene, substeps: Array, theta: Array, guesses: Pose) -> Any:
    """Values (N, n, c), start poses, and whether those are equilibria (N,), for parameters (N, p)."""

    def batch(shared: tuple[Scene, Array], thetas: Array, near: Pose) -> Any:
        return batched(lambda t, g: program.predicted(shared[0], t, g, shared[1]))(thetas, near)

    return _sharded(program.mesh, batch, (scene, substeps), (theta, guesses))


@Program
def with_slopes(program: FitProgram, scene: Scene, substeps: Array, theta: Array, guesses: Pose) -> Any:
    """As `predictions`, and derivatives (p, N, n, c). Parameters outside, variants inside: the fastest memory order."""

    def pushed(shared: tuple[Scene, Array], thetas: Array, near: Pose) -> Any:
        def batch(some: Array) -> Any:
            out = batched(lambda t, g: program.predicted(shared[0], t, g, shared[1]))(some, near)
            return out[0], out[1:]

        def pushforward(direction: Array) -> Any:
            return jax.jvp(batch, (thetas,), (jnp.broadcast_to(direction, thetas.shape),))

        directions = jnp.eye(len(program.places), dtype=thetas.dtype)
        (values, rest), (slopes, _) = jax.vmap(pushforward, out_axes=(None, 0))(directions)
        return (values, *rest), slopes

    return _sharded(program.mesh, pushed, (scene, substeps), (theta, guesses), (SPLIT, _COLUMNS))


@Program
def loss_gradients(
    program: FitProgram, scene: Scene, substeps: int, theta: Array, guesses: Pose, pulls: Array
) -> Array:
    """Gradients (N, p) of sum(pull * prediction) by reverse mode, for pulls (N, n, c); the step count is static."""

    def loss(theta: Array, shared: Scene, guess: Pose, pull: Array) -> Array:
        return jnp.sum(pull * program.predicted(shared, theta, guess, substeps)[0])

    def batch(shared: Scene, *rows: Any) -> Array:
        return jax.vmap(lambda t, guess, pull: jax.grad(loss)(t, shared, guess, pull))(*rows)

    return _sharded(program.mesh, batch, scene, (theta, guesses, pulls))


def mesh_of(devices: tuple[Any, ...]) -> Mesh | None:
    """The mesh over these devices; None for JAX's default device alone."""
    return None if devices == (jax.local_devices()[0],) else Mesh(np.array(devices), (AXIS,))
