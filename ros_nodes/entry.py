"""Where the command starts: signals are taken care of before anything heavy is imported."""

import signal
import sys

from config.errors import Interrupted

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def _interrupt(_number: int, _frame: object) -> None:
    """Ends the command in order; a second signal doesn't disturb what is being made safe."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise Interrupted


def main() -> None:
    """Runs the command line."""
    for number in SIGNALS:
        signal.signal(number, _interrupt)
    try:
        from ros_nodes.cli import main as command_line

        command_line()
    except Interrupted as interruption:
        print(f"pallet-twin: {interruption}", file=sys.stderr)
        sys.exit(interruption.exit_code)


if __name__ == "__main__":
    main()
