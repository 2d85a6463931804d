"""A training program that knows nothing of fl3d, and learns nothing: it writes KITTI result files after every epoch.

Its "network" is how far labels are shifted: less with every epoch. It stands for programs of any kind in tests.
"""

import argparse
import json
import random
import sys
import time
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("--data", "--val", "--out"):
        parser.add_argument(name, type=Path, required=True)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--gamma", type=float, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--init", type=Path)
    parser.add_argument("--first", type=int, default=1, help="number of the first epoch")
    parser.add_argument("--leave-out", type=int, default=0, help="frames without a file")
    parser.add_argument("--add", action="append", default=[], help="a frame that nobody asked for")
    parser.add_argument("--slow", type=float, default=0, help="seconds of an epoch")
    parser.add_argument("--fail-after", type=int, help="epoch after which it ends with code 3")
    parser.add_argument("--note", default="")
    args = parser.parse_args()
    last = args.out / "last.json"
    state = {"epoch": 0, "all": 0}
    if args.init is not None:
        state["all"] = json.loads(args.init.read_text())["all"]
    if last.exists():
        state = json.loads(last.read_text())
        print(f"goes on after epoch {state['epoch']}", flush=True)
    print(f"note: {args.note}", flush=True)
    ids = args.val.read_text().split()
    for epoch in range(state["epoch"] + 1, args.epochs + 1):
        time.sleep(args.slow)
        state = {"epoch": epoch, "all": state["all"] + 1}
        print(f"epoch {epoch - 1 + args.first} loss {1 / state['all']:.3f}", flush=True)
        folder = args.out / "results" / f"epoch_{epoch - 1 + args.first}" / "data"
        folder.mkdir(parents=True, exist_ok=True)
        for name in ids[args.leave_out :]:
            labels = (args.data / "training" / "label_2" / f"{name}.txt").read_text().splitlines()
            shift = (1 + args.gamma / 10) / state["all"]
            (folder / f"{name}.txt").write_text(
                results(labels, shift, f"{args.seed} {name} {epoch}")
            )
        for name in args.add:
            (folder / f"{name}.txt").write_text("")
        last.write_text(json.dumps(state))
        if epoch == args.fail_after:
            print("out of luck", flush=True)
            sys.exit(3)


def results(labels: list[str], shift: float, seed: str) -> str:
    """Shifted labels with scores, and false alarms, as KITTI result lines."""
    rng = random.Random(seed)
    lines = []
    for label in labels:
        fields = label.split()
        if fields[0] == "DontCare":
            continue
        x, z = (float(fields[i]) + rng.gauss(0, 0.2 * shift) for i in (11, 13))
        fields[11], fields[13] = f"{x:.3f}", f"{z:.3f}"
        lines.append(" ".join([*fields[:15], f"{rng.random() * 0.5 + 0.5:.4f}"]))
        if rng.random() < 0.3:  # a false alarm beside it
            fields[13] = f"{z + 9:.3f}"
            lines.append(" ".join([*fields[:15], f"{rng.random() * 0.6:.4f}"]))
    return "".join(f"{line}\n" for line in lines)


if __name__ == "__main__":
    main()
