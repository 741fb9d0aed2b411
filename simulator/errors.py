"""The errors of the simulator, each one sentence for the user."""


class InputError(ValueError):
    """Input that cannot be used. The message says what was expected, what came and what to do."""


class Interrupted(KeyboardInterrupt):
    """A run that Ctrl-C or a signal ended between two steps.

    Parameters
    ----------
    motion : simulator.motion.Motion with the states reached; `stopped` says at what time, None if it was complete
    signal : number of the signal
    """

    def __init__(self, motion, signal: int):
        super().__init__(str(motion.stopped))
        self.motion, self.signal = motion, signal
