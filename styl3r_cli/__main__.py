"""The console script, and `python -m styl3r_cli`, which is the same."""

import signal
import sys


def main() -> None:
    """Run the command line and exit; Ctrl-C while it is being loaded is as quiet as later."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    _check_limits()
    from styl3r_cli.main import main as run_command_line

    run_command_line()


def _check_limits() -> None:
    """Refuse a limit that not even what tells of errors could be loaded under."""
    from styl3r_cli import limits, needs
    from styl3r_cli.errors import OutOfMemoryError

    try:
        limits.check(needs.TO_START)
    except OutOfMemoryError as error:
        sys.stderr.write(f"styl3r: error: {error}\n")
        sys.exit(int(error.exit_code))


if __name__ == "__main__":
    main()
