"""The family of errors that a user can meet; the command line turns each into one line and one exit code."""


class PalletTwinError(Exception):
    """Base of every error that ends a command with one line instead of a traceback.

    Attributes:
        exit_code: what the process returns to its caller.
    """

    exit_code = 1


class RefusedInput(PalletTwinError):
    """An input that cannot be used, named by field, value and limit.

    Args:
        field: where the value stands, as a dotted path into the file it came from.
        value: the offending value, shortened for display.
        limit: what would have been accepted, or what to do about it.
    """

    exit_code = 2

    def __init__(self, field: str, value: object, limit: str) -> None:
        self.field = field
        self.value = value
        self.limit = limit
        shown = value if isinstance(value, str) else repr(value)
        if len(shown) > 120:
            shown = shown[:117] + "..."
        super().__init__(" ".join(f"{field} = {shown}: {limit}".split()))


class BrokenRecording(RefusedInput):
    """A recording that is damaged, cut short or not a recording at all."""


class EndedByMonitor(PalletTwinError):
    """A run that could not be trusted any longer and was ended.

    Args:
        monitor: name of the monitor, such as ``penetration``.
        reason: measured value, threshold and place, with units.
        time_s: simulated time of the breach, in seconds since the first sample.
    """

    exit_code = 3

    def __init__(self, monitor: str, reason: str, time_s: float) -> None:
        self.monitor = monitor
        self.reason = reason
        self.time_s = time_s
        super().__init__(f"ended by monitor '{monitor}' at {time_s:.4f} s: {reason}")


class NodeDied(PalletTwinError):
    """A node of the graph ended before the test did.

    Args:
        node: the node's executable name.
        reason: how it ended, and its last words.
    """

    exit_code = 3

    def __init__(self, node: str, reason: str) -> None:
        self.node = node
        self.reason = reason
        super().__init__(f"{node} died: {reason}")


class Interrupted(PalletTwinError):
    """A user's Ctrl-C, or a request to terminate."""

    exit_code = 130

    def __init__(self) -> None:
        super().__init__("interrupted; what is on disk is whole")
