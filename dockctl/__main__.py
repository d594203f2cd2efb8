"""The entry point of ``dockctl``, and ``python -m dockctl``, where its script is not on the path."""

import sys


def main() -> None:
    """Run the command line. Ctrl-C during imports ends it like Ctrl-C later."""
    try:
        from dockctl import cli

        cli.main()
    except KeyboardInterrupt:
        sys.exit(130)  # as `dockctl.experiments.interrupt.INTERRUPTED`, which may not be imported yet


if __name__ == "__main__":
    main()
