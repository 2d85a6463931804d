"""`python -m fl3d`."""

from fl3d.core import interrupts
from fl3d.core.loading import leave_quickly, uncollected


def main() -> None:
    """Run what was typed; signals are heard before anything heavy is loaded."""
    interrupts.listen()
    leave_quickly()
    with uncollected():
        from fl3d.cli import main as run

    run()


if __name__ == "__main__":
    main()
