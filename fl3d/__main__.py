"""`python -m fl3d`."""

from fl3d.cli import main

if __name__ == "__main__":
    main()
