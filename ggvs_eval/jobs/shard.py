"""One part of a sweep, for one of several machines: whole views, which no measure needs another
view for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from ggvs_eval.errors import ProtocolError

Unit = TypeVar("Unit")


@dataclass(frozen=True)
class Shard:
    """Every n-th view of a sweep.

    The shards of one n have no view in common and together all of them.

    Attributes:
        number: from 1 to `count`; 0 has no view, so that it only prepares what all others need.
        count: how many shards there are.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """``i/n`` as it is typed."""
        number, _, count = text.partition("/")
        if not (
            number.isdecimal()
            and count.isdecimal()
            and int(number) <= int(count)
            and int(count) > 0
        ):
            raise ProtocolError(
                f"--shard {text}: wanted i/n with i from 1 to n, such as 2/5, or 0/n to prepare "
                f"only"
            )
        return cls(int(number), int(count))

    @property
    def is_whole(self) -> bool:
        """True if this shard is all there is to do."""
        return self == WHOLE

    @property
    def prepares_only(self) -> bool:
        """True if this shard renders nothing."""
        return self.number == 0

    def pick(self, units: Sequence[Unit]) -> list[Unit]:
        """This shard's share of what all shards list in the same order.

        Examples:
            >>> Shard.parse("2/3").pick(["cam00", "cam01", "cam02", "cam03", "cam04"])
            ['cam01', 'cam04']
        """
        return [] if self.prepares_only else list(units[self.number - 1 :: self.count])


WHOLE = Shard(1, 1)
