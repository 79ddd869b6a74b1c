"""The console script, and `python -m styl3r_cli`, which is the same."""

import signal


def main() -> None:
    """Run the command line and exit; Ctrl-C while it is being loaded is as quiet as later."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from styl3r_cli.main import main as run_command_line

    run_command_line()


if __name__ == "__main__":
    main()
