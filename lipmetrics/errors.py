"""The one error that bad input raises: a sentence for the user, exit code 2 at the command line."""


class InputError(ValueError):
    """Input that cannot be used. The message says what was expected, what came and what to do."""
