"""Reasons of a HOLD, STOP or FAULT: the first cause is kept until the reset, later ones are appended."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StopReasons:
    """Causes of HOLD, STOP or FAULT since the last reset, in their order, each once."""

    texts: tuple[str, ...] = ()

    def add(self, text: str) -> "StopReasons":
        """Return the causes with one more; a cause that is already known is not added again."""
        return self if not text or text in self.texts else StopReasons((*self.texts, text))

    def extend(self, text: str) -> "StopReasons":
        """Return the causes with `text` in place of the cause that `text` starts with.

        The text of a lost serial link grows, because the axes miss their polls one after the other.
        """
        return StopReasons(tuple(text if text.startswith(known) else known for known in self.texts))

    def __str__(self) -> str:
        return "; then ".join(self.texts)
