"""Why the station stands still: the first cause stands until the reset, and what came later is added to it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Causes:
    """What has happened since the last reset, in that order, each once."""

    texts: tuple[str, ...] = ()

    def add(self, text: str) -> "Causes":
        """With one more; what is known already changes nothing."""
        return self if not text or text in self.texts else Causes((*self.texts, text))

    def extend(self, text: str) -> "Causes":
        """With more words for the cause that `text` begins with: one axis after the other is missed."""
        return Causes(tuple(text if text.startswith(known) else known for known in self.texts))

    def __str__(self) -> str:
        return "; then ".join(self.texts)
