"""The one error that a user sees: a sentence saying what is wrong, with which value, and what to do."""


class RigError(ValueError):
    """Input that cannot be used. Its text is one sentence for the user; the commands print it and exit with 1."""


class CutOffError(RigError):
    """A recording that could not be written to its end, though what was written of it is kept."""

    def __init__(self, sentence: str, strerror: str) -> None:
        super().__init__(sentence)
        self.strerror = strerror
