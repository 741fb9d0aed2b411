"""The one error that bad input raises: a sentence for the user, exit code 2 at the command line."""

LONGEST_MESSAGE = 600  # characters


class InputError(ValueError):
    """Input that cannot be used. The message says what was expected, what came and what to do, on one line.

    What came may be long or of several lines, as what is in a damaged file: the middle of a long message is left out.
    """

    def __init__(self, message: str = ""):
        text = " ".join(str(message).split("\n"))
        if len(text) > LONGEST_MESSAGE:
            text = f"{text[: LONGEST_MESSAGE * 2 // 3]} ... {text[-LONGEST_MESSAGE // 4 :]}"
        super().__init__(text)
