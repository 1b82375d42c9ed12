"""What was assumed, changed or ignored while a scene is read or written: sentences for the user."""

from dataclasses import dataclass, field


@dataclass
class Notes:
    """Collects sentences; what concerns several things is said once, with their names."""

    _texts: list[str] = field(default_factory=list)
    _groups: dict[str, list[str]] = field(default_factory=dict)

    def add(self, text: str) -> None:
        """A sentence of its own; said once."""
        if text not in self._texts:
            self._texts.append(text)

    def group(self, text: str, name: str) -> None:
        """A sentence that may hold for several things; `name` is one of them."""
        names = self._groups.setdefault(text, [])
        if name not in names:
            names.append(name)

    def sentences(self) -> list[str]:
        """All of them: grouped ones first, each with the first five names and the number of the others."""
        grouped = []
        for text, names in self._groups.items():
            more = f" and {len(names) - 5} more" * (len(names) > 5)
            grouped.append(f"{text}: {', '.join(names[:5])}{more}")
        return grouped + self._texts
