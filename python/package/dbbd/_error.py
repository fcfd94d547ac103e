class DbbdError(Exception):
    """What a command would have refused.

    ``code`` is stable (``dbbd explain CODE`` prints its cause and cure); the text is that of the command line.
    """

    code: str

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code

    def __reduce__(self):
        return (type(self), (self.code, str(self)))


class DbbdWarning(UserWarning):
    """What a command would have reported as a warning (exit code 3), such as that the identification of a robot has warnings."""

    code: str

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code

    def __reduce__(self):
        return (type(self), (self.code, str(self)))
