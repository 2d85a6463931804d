"""`python -m fl3d`."""

from fl3d.core import interrupts


def main() -> None:
    """Run what was typed; signals are heard before anything heavy is loaded."""
    interrupts.listen()
    from fl3d.cli import main as run

    run()


if __name__ == "__main__":
    main()
