"""Which part of a data set a run makes, where several machines share its folder."""

from __future__ import annotations

from dataclasses import dataclass

from scenetruth.errors import Problem, RecipeError

__all__ = ["Part"]


@dataclass(frozen=True)
class Part:
    """Which part of a data set a run makes.

    Parameters
    ----------
    number, count
        The number-th of count parts, from 1.

    Examples
    --------
    >>> [number for number in range(10) if number in Part(2, 3).numbers(10)]
    [3, 4, 5]
    >>> Part.read("2/3")
    Part(number=2, count=3)
    """

    number: int = 1
    count: int = 1

    @staticmethod
    def read(text: str) -> Part:
        """Return the part that a text such as ``3/10`` names.

        Raises
        ------
        RecipeError
            If it names none.
        """
        first, separator, second = text.partition("/")
        if separator and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second) <= 1_000_000:
            return Part(int(first), int(second))
        raise RecipeError([Problem("--part", "must read NUMBER/PARTS, as 3/10", text)])

    def numbers(self, count: int, together: int = 1) -> range:
        """Return the numbers of the samples of this part, of so many in all, of which some stay together."""
        groups = -(-count // together)
        first, last = groups * (self.number - 1) // self.count, groups * self.number // self.count
        return range(min(first * together, count), min(last * together, count))

    @property
    def label(self) -> str:
        """What distinguishes it in names of files."""
        return f"{self.number}of{self.count}"
