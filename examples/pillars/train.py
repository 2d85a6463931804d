"""A small pillar detector of cars: trains on a KITTI folder, and writes KITTI result files after every epoch.

    python train.py --data KITTI --train train.txt --val val.txt --out OUT --epochs 10 --gamma 2 --seed 0

OUT/last.pt is its checkpoint, from which the same command goes on; OUT/results/epoch_N/ holds the results.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

X, Y, Z = (0.0, 38.4), (-19.2, 19.2), (-3.0, 1.5)  # metres, LiDAR frame
PILLAR, CELL = 0.4, 0.8  # metres: a pillar's edge, an output cell's
PICTURE = (1242, 375)  # pixels
MEAN = torch.tensor([-1.0, math.log(1.5), math.log(1.6), math.log(3.9)])  # of cars: z, log h, log w, log l


class Pillars(nn.Module):
    """Features of the points of each pillar, convolutions over the map of pillars, a car's centre in each cell."""

    def __init__(self):
        super().__init__()
        self.side = round((X[1] - X[0]) / PILLAR)
        self.points = nn.Sequential(nn.Linear(7, 32, bias=False), nn.BatchNorm1d(32), nn.ReLU())
        layers = []
        for i, (c_in, c_out, stride) in enumerate([(32, 48, 1), (48, 64, 2), (64, 64, 1), (64, 64, 1), (64, 64, 1)]):
            dilation = 2 if i == 3 else 1
            layers.append(nn.Conv2d(c_in, c_out, 3, stride, dilation, dilation, bias=False))
            layers += [nn.BatchNorm2d(c_out), nn.ReLU()]
        self.map = nn.Sequential(*layers)
        self.head = nn.Conv2d(64, 9, 1)
        nn.init.constant_(self.head.bias[0], -4.0)

    def forward(self, clouds):
        """Clouds (N_i, 4) -> (B, 9, cells, cells): logit, x, y in the cell, z, log h, w, l, sin and cos of the yaw."""
        frame = torch.cat([torch.full((len(c),), i) for i, c in enumerate(clouds)])
        xyzi = torch.cat(clouds)
        cell = ((xyzi[:, :2] - torch.tensor([X[0], Y[0]])) / PILLAR).long()
        place = (frame * self.side + cell[:, 0]) * self.side + cell[:, 1]
        offset = (xyzi[:, :2] - torch.tensor([X[0], Y[0]])) / PILLAR - cell - 0.5
        count = torch.zeros(len(clouds) * self.side**2).index_add_(0, place, torch.ones(len(place)))
        own = [xyzi[:, 2:3], xyzi[:, 3:4], offset, torch.log(count[place])[:, None], xyzi[:, :2] / 40]
        features = self.points(torch.cat(own, 1))
        index = place[:, None].expand_as(features)
        canvas = torch.zeros(len(count), 32).scatter_reduce(0, index, features, "amax")
        return self.head(self.map(canvas.view(len(clouds), self.side, self.side, 32).permute(0, 3, 1, 2)))


class Frames:
    """Frames of a KITTI folder, read once: points in range, cars in the LiDAR frame, calibration."""

    def __init__(self, root, ids):
        self.root, self.ids = Path(root) / "training", ids
        self.kept = {}

    def __getitem__(self, i):
        if i not in self.kept:
            self.kept[i] = self._read(self.ids[i])
        return self.kept[i]

    def _read(self, name):
        rows = (line.split(":") for line in (self.root / f"calib/{name}.txt").read_text().splitlines() if ":" in line)
        calib = {key: np.array(values.split(), float) for key, values in rows}
        to_cam, rect = np.eye(4), np.eye(4)
        to_cam[:3], rect[:3, :3] = calib["Tr_velo_to_cam"].reshape(3, 4), calib["R0_rect"].reshape(3, 3)
        to_cam = rect @ to_cam
        points = np.fromfile(self.root / f"velodyne/{name}.bin", np.float32).reshape(-1, 4)
        low, high = np.array([X[0], Y[0], Z[0]]), np.array([X[1], Y[1], Z[1]])
        points = points[((points[:, :3] >= low) & (points[:, :3] < high - 1e-4)).all(1)]
        cars = []
        for line in (self.root / f"label_2/{name}.txt").read_text().splitlines():
            kind, *numbers = line.split()
            h, w, length, *center, ry = map(float, numbers[7:14])
            center = (np.linalg.inv(to_cam) @ [*center, 1])[:3]
            if kind == "Car" and (center >= low).all() and (center < high).all():
                cars.append([*center, h, w, length, -ry - math.pi / 2])
        cars = torch.tensor(np.array(cars).reshape(-1, 7), dtype=torch.float32)
        return torch.from_numpy(points), cars, to_cam, calib["P2"].reshape(3, 4)


def targets(cars):
    """Cells (N, 2) of cars and what is to be found in them (N, 8)."""
    place = (cars[:, :2] - torch.tensor([X[0], Y[0]])) / CELL
    cell = place.long()
    shape = torch.cat([cars[:, 2:3], cars[:, 3:6].log()], 1) - MEAN
    yaw = cars[:, 6:7]
    return cell, torch.cat([place - cell - 0.5, shape, yaw.sin(), yaw.cos()], 1)


def loss_of(outputs, batch, gamma):
    """Focal loss of all cells over the number of cars, and a smooth L1 loss of the cars' cells."""
    wanted, weight = torch.zeros_like(outputs[:, 0]), torch.ones_like(outputs[:, 0])
    found, boxes = [], []
    for i, (_, cars, _, _) in enumerate(batch):
        cell, box = targets(cars)
        for x, y in cell.tolist():  # cells beside a car's are neither
            weight[i, max(0, x - 1) : x + 2, max(0, y - 1) : y + 2] = 0
        found.append(outputs[i, 1:, cell[:, 0], cell[:, 1]].T)
        boxes.append(box)
        wanted[i, cell[:, 0], cell[:, 1]] = 1
    weight[wanted == 1] = 1
    bce = F.binary_cross_entropy_with_logits(outputs[:, 0], wanted, reduction="none")
    focal = (1 - torch.exp(-bce)) ** gamma * bce * weight
    n = max(1.0, float(wanted.sum()))
    return focal.sum() / n + 2 * F.smooth_l1_loss(torch.cat(found), torch.cat(boxes), reduction="sum", beta=0.1) / n


def decode(output):
    """Boxes (N, 7) and scores of a frame: the best cells, without those near a better one."""
    side = output.shape[1]
    best = output[0].sigmoid().flatten().topk(60)
    cell = torch.stack([best.indices // side, best.indices % side], 1)
    values = output[1:, cell[:, 0], cell[:, 1]].T
    xy = (cell + 0.5 + values[:, :2]) * CELL + torch.tensor([X[0], Y[0]])
    shape = values[:, 2:6] + MEAN
    yaw = torch.atan2(values[:, 6:7], values[:, 7:8])
    boxes = torch.cat([xy, shape[:, :1], shape[:, 1:].clamp(-2, 3).exp(), yaw], 1)
    kept = []
    for i in range(len(boxes)):
        if all((boxes[i, :2] - boxes[k, :2]).norm() > 1.6 for k in kept):
            kept.append(i)
    return boxes[kept].double().numpy(), best.values[kept].double().numpy()


def write(path, boxes, scores, to_cam, p2):
    """A KITTI result file; boxes outside the picture are left out."""
    lines = []
    for (x, y, z, h, w, length, yaw), score in zip(boxes, scores, strict=True):
        center = (to_cam @ [x, y, z, 1])[:3]
        ry = (-yaw - math.pi / 2 + math.pi) % (2 * math.pi) - math.pi
        turn = np.array([[math.cos(ry), 0, math.sin(ry)], [0, 1, 0], [-math.sin(ry), 0, math.cos(ry)]])
        corners = [[a * length / 2, b * h, c * w / 2] for a in (-1, 1) for b in (-1, 0) for c in (-1, 1)]
        pixels = p2 @ np.c_[np.array(corners) @ turn.T + center, np.ones(8)].T
        if (pixels[2] < 0.1).any():
            continue
        u, v = (np.clip(pixels[k] / pixels[2], 0, PICTURE[k] - 1) for k in (0, 1))
        if u.max() > u.min() and v.max() > v.min():
            alpha = ry - math.atan2(center[0], center[2])
            numbers = [u.min(), v.min(), u.max(), v.max(), h, w, length, *center, ry]
            lines.append(f"Car -1 -1 {alpha:.2f} {' '.join(f'{n:.2f}' for n in numbers)} {score:.6f}\n")
    path.write_text("".join(lines))


def main():
    """Train, and write results and a checkpoint after every epoch."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("--data", "--train", "--val", "--out"):
        parser.add_argument(name, required=True, type=Path)
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--gamma", type=float, default=0.0)
    parser.add_argument("--lr", type=float, default=2e-3)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--init", type=Path, help="weights to begin with")
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    train, val = (Frames(args.data, path.read_text().split()) for path in (args.train, args.val))
    net = Pillars()
    optimizer = torch.optim.Adam(net.parameters(), args.lr)
    begin, last = 0, args.out / "last.pt"
    if last.exists() or args.init:
        state = torch.load(last if last.exists() else args.init)
        net.load_state_dict(state["net"])
        if last.exists():
            optimizer.load_state_dict(state["optimizer"])
            begin = state["epoch"]
            print(f"goes on after epoch {begin}", flush=True)
    for epoch in range(begin + 1, args.epochs + 1):
        net.train()
        order = np.random.default_rng([args.seed, epoch]).permutation(len(train.ids))
        batches = np.array_split(order, math.ceil(len(order) / args.batch))
        for step, chosen in enumerate(batches, 1):
            batch = [train[i] for i in chosen]
            loss = loss_of(net([frame[0] for frame in batch]), batch, args.gamma)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 10.0)
            optimizer.step()
            if step % 10 == 0 or step == len(batches):
                print(f"epoch {epoch} step {step}/{len(batches)} loss {loss.item():.4f}", flush=True)
        net.eval()
        folder = args.out / f"results/epoch_{epoch}"
        folder.mkdir(parents=True, exist_ok=True)
        with torch.no_grad():
            for i, name in enumerate(val.ids):
                points, _, to_cam, p2 = val[i]
                write(folder / f"{name}.txt", *decode(net([points])[0]), to_cam, p2)
        state = {"net": net.state_dict(), "optimizer": optimizer.state_dict(), "epoch": epoch}
        torch.save(state, last.with_suffix(".tmp"))
        last.with_suffix(".tmp").replace(last)


if __name__ == "__main__":
    main()
