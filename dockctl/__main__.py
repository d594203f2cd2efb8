"""``python -m dockctl``: the command line, also where its script is not on the path."""

from dockctl.cli import main

if __name__ == "__main__":
    main()
