"""The errors of the study, each one sentence for the user."""


class InputError(ValueError):
    """Input that cannot be used. The message says what was expected, what came and what to do."""
