"""``python -m pcretrieve``."""

from pcretrieve.cli.main import main

if __name__ == "__main__":
    main()
