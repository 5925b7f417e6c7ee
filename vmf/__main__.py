"""`python -m vmf`."""

from vmf.cli import main

if __name__ == "__main__":
    main()
