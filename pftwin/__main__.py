"""`python -m pftwin`: the command line, where its script is not on the path."""

from pftwin.cli import main

if __name__ == "__main__":
    main()
