"""Lines of force between the patella and a guided body, straight or wrapped around an obstacle on a bone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.errors import InputError
from pftwin.base.leaves import traced_once
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.base import Effect, Instant, StiffTerm, applied_at
from pftwin.model.motion import SegmentMotion

# Labels of the `Change`s of tendons and strands.
DAMPING, TOE = "tendons' damping", "toe region"


class Line(NamedTuple):
    """A line from its insertion on the patella to its origin on a guided body."""

    length: Scalar  # [m]
    lengthening: Scalar  # d length / dt [m/s]
    direction: Vec3  # unit vector from the insertion to the origin, world
    moment: Vec3  # of a unit tension about the patella's centre of mass, patella axes [m]

    def term(self, tension: Scalar, elastic: Scalar, stiffness: Scalar, damping: Scalar) -> StiffTerm:
        """The tension along this line as a stiff term."""
        return StiffTerm(self.direction, self.moment, tension, elastic, stiffness, damping, self.lengthening)


@traced_once
def line_of_force(now: Instant, insertion: Vec3, body: str, origin: Vec3) -> Line:
    """The straight line from the point `insertion` of the patella to the point `origin` of `body`, in their frames [m].

    Where the two points coincide, the direction is the zero vector, with finite derivatives.
    """
    patella, segment = now.patella, now.segment(body)
    arm = patella.arm(insertion)
    anchor = segment.point(origin)
    line = anchor - (patella.position + arm)
    length = line.norm()
    direction = line * (1 / jnp.where(length > 1e-9, length, 1e-9))
    velocity = segment.relative_velocity(patella.velocity_at(arm), anchor)
    return Line(length, -direction.dot(velocity), direction, applied_at(insertion, patella, direction))


@traced_once
def wrapped_line_of_force(now: Instant, insertion: Vec3, body: str, origin: Vec3, wrap: Obstacle) -> Line:
    """As `line_of_force`, around an obstacle. `direction` is that of the pull at the patella.

    The bones that carry the obstacle and the origin bear the rest. An obstacle on the patella presses on it, so the
    pull there acts as if the line were attached where it leaves the obstacle for the origin.
    """
    patella, segment = now.patella, now.segment(body)
    arm = patella.arm(insertion)
    end, anchor = patella.position + arm, segment.point(origin)
    if wrap.body == "patella":
        arm = anchor - patella.position
        there = patella.rotation.unapply(arm)  # any point along the line of action
        taut = wrap.around(insertion, there)
        direction = -patella.rotation.apply(taut.at_end)
        velocity = segment.relative_velocity(patella.velocity_at(arm), anchor)
        return Line(taut.length, -direction.dot(velocity), direction, applied_at(there, patella, direction))
    bone = now.segment(wrap.body)
    taut = wrap.around(bone.to_local(end), bone.to_local(anchor))
    direction = bone.direction(taut.at_start)
    lengthening = -direction.dot(bone.relative_velocity(patella.velocity_at(arm), end))
    if body != wrap.body:
        still = Vec3.zero()
        velocity = bone.relative_velocity(still, anchor) - segment.relative_velocity(still, anchor)
        lengthening = lengthening - bone.direction(taut.at_end).dot(velocity)
    return Line(taut.length, lengthening, direction, applied_at(insertion, patella, direction))


class LineElement(Effect):
    """Base class of effects that pull along lines from `insertion` on the patella to `origin` on the guided `body` [m].

    The lines are straight, or wrap around the obstacle in the field `wrap`.

    Subclasses declare these fields and the tension. Other modules fit, move, lengthen or draw lines of force through
    this interface.
    """

    elastic: ClassVar[bool] = False  # whether it has a stiffness and a slack length: see `ElasticLine`

    if TYPE_CHECKING:  # fields of the subclasses, whose order differs between them

        @property
        def insertion(self) -> Vec3: ...  # noqa: D102
        @property
        def origin(self) -> Vec3: ...  # noqa: D102
        @property
        def body(self) -> str: ...  # noqa: D102

    @property
    def wrap(self) -> Obstacle | None:
        """Obstacle that the lines wrap around: the field `wrap` of a subclass, else None."""
        return None

    @property
    def line_ends(self) -> tuple[Vec3, str]:
        """The insertions, patella frame [m], and the body of the origins: "femur", "tibia" or "ground"."""
        return self.insertion, self.body

    def origin_at(self, time: Scalar | float) -> Vec3:
        """The origins [m] in their body's frame at a time in seconds; constant unless overridden."""
        return self.origin

    def with_origin_moved(self, by: Vec3) -> Self:
        """The element with its origins moved by a vector in their body's frame [m]."""
        return eqx.tree_at(lambda t: t.origin, self, self.origin + by)

    def pulls(self) -> Any:
        """Which of the lines can bear tension at some time, boolean (n_lines,); all (True) unless overridden."""
        return True

    def recentred(self, center_of_mass: Vec3) -> Self:
        """The element with insertions, and an obstacle on the patella, relative to the centre of mass."""
        moved = eqx.tree_at(lambda t: t.insertion, self, self.insertion - center_of_mass)
        if self.wrap is None or self.wrap.body != "patella":
            return moved
        return eqx.tree_at(lambda t: t.wrap.center, moved, self.wrap.center - center_of_mass)

    def in_still_femur(self, femur: SegmentMotion) -> Self | None:
        """See `Effect`; None for lines from the ground, which moves in the femur's frame."""
        return None if self.body == "ground" else self

    def line_element(self) -> LineElement:
        """This effect."""
        return self

    @property
    def count(self) -> int | None:
        """Number of lines of a group; None for a single line."""
        x = self.insertion.x
        return None if jnp.ndim(x) == 0 else jnp.shape(x)[0]

    def depth_in_wrap(self, now: Instant) -> Scalar:
        """Depth of the deeper end inside the obstacle [m], at most 0 outside; lines with an end inside run straight."""
        if self.wrap is None:
            return jnp.zeros(())
        patella, anchor = now.patella, now.segment(self.body).point(self.origin_at(now.time))
        if self.wrap.body == "patella":
            ends = self.insertion, patella.rotation.unapply(anchor - patella.position)
        else:
            bone = now.segment(self.wrap.body)
            ends = bone.to_local(patella.position + patella.arm(self.insertion)), bone.to_local(anchor)
        return jnp.maximum(*(self.wrap.depth(end) for end in ends))

    def line(self, now: Instant) -> Line:
        """Geometry of the lines at an instant."""
        ends = self.insertion, self.body, self.origin_at(now.time)
        return line_of_force(now, *ends) if self.wrap is None else wrapped_line_of_force(now, *ends, self.wrap)


class ElasticLine(LineElement):
    """Base class of lines whose tension depends on a `stiffness` and the stretch beyond a `slack_length` [m]."""

    elastic: ClassVar[bool] = True

    if TYPE_CHECKING:  # fields of the subclasses, whose order differs between them

        @property
        def stiffness(self) -> Scalar: ...  # noqa: D102
        @property
        def slack_length(self) -> Scalar: ...  # noqa: D102

    def lengthened(self, by: Scalar | float) -> Self:
        """The element with `by` [m] added to the slack length of every line."""
        return eqx.tree_at(lambda t: t.slack_length, self, self.slack_length + by)

    def stiffened(self, share: Scalar | float) -> Self:
        """The element with its stiffness multiplied by the factor `share`."""
        return eqx.tree_at(lambda t: t.stiffness, self, self.stiffness * share)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """The slack length [m] for which a line held at `length` [m] has the tension `tension` [N].

        Raises:
            InputError: not defined for this effect.
        """
        raise self._unknown_tension()

    def held_tension(self, length: Scalar) -> Scalar:
        """The static tension [N] at a length [m]: the inverse of `slack_length_for`.

        Raises:
            InputError: not defined for this effect.
        """
        raise self._unknown_tension()

    def _unknown_tension(self) -> InputError:
        kind = type(self).__name__
        return InputError(f"{kind} does not say how its slack length follows from a tension", where=self.name)
