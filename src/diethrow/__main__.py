"""`python -m diethrow` is the program `diethrow`."""

from .cli import main

if __name__ == "__main__":
    main()
