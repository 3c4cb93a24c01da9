"""``python -m truejoint``: the command line."""

from truejoint.cli.app import main

if __name__ == "__main__":
    main()
