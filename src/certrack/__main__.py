"""``python -m certrack``: the command line where no command ``certrack`` is on the path."""

from certrack.cli import main

if __name__ == "__main__":
    main()
