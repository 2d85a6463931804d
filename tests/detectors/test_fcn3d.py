"""3D-FCN's targets and their way back."""

import numpy as np
import torch

from fl3d.config.compose import compose_config
from fl3d.detectors.fcn3d import FCN3D
from fl3d.geometry.boxes import rectangles_velo
from fl3d.geometry.iou import bev_iou
from fl3d.inference.load import build_detector


def make(*overrides: str) -> FCN3D:
    detector = build_detector(compose_config(["detector=fcn3d", "profile=quick", *overrides]))
    assert isinstance(detector, FCN3D)
    return detector


CAR = np.array([[10.1, 3.3, -1.7, 1.5, 1.6, 4.0, 0.3]])


def test_the_cell_of_a_car_holds_its_centre() -> None:
    """Cells are 1.6 m: x 10.1 -> 6, y 3.3 + 19.2 -> 14, z -1.7 + 0.75 + 3 -> 1."""
    cells, corners = make().assign(CAR)
    assert cells.tolist() == [[1, 14, 6]]
    assert corners.shape == (1, 24)
    first = corners[0, :3] + make().origins(cells)[0]
    expected = CAR[0, :3] + np.array(
        [-2 * np.cos(0.3) + 0.8 * np.sin(0.3), -2 * np.sin(0.3) - 0.8 * np.cos(0.3), 0]
    )
    np.testing.assert_allclose(first, expected, atol=1e-5)


def test_front_and_back_have_the_same_target() -> None:
    turned = CAR + np.array([0, 0, 0, 0, 0, 0, np.pi])
    np.testing.assert_allclose(make().assign(CAR)[1], make().assign(turned)[1], atol=1e-5)


def test_cars_out_of_range_and_long_things_have_no_cell() -> None:
    boxes = np.concatenate([CAR + [100, 0, 0, 0, 0, 0, 0], CAR + [0, 0, 0, 0, 0, 8, 0]])
    assert len(make().assign(boxes)[0]) == 0


def test_of_two_centres_in_one_cell_the_nearer_stays() -> None:
    boxes = np.concatenate([CAR + [0.3, 0, 0, 0, 0, 0, 0], CAR])
    cells, corners = make().assign(boxes)
    assert len(cells) == 1
    np.testing.assert_allclose(corners, make().assign(CAR)[1])


def test_perfect_outputs_decode_to_the_cars() -> None:
    detector = make()
    boxes = np.concatenate([CAR, CAR + [12, -9, 0.1, 0.2, 0.1, 0.4, 1.2]])
    cells, corners = detector.assign(boxes)
    nz, ny, nx = detector.cells
    logits, offsets = torch.full((1, nz, ny, nx), -9.0), torch.zeros(1, nz, ny, nx, 24)
    z, y, x = torch.from_numpy(cells).unbind(1)
    logits[0, z, y, x], offsets[0, z, y, x] = 9.0, torch.from_numpy(corners)
    detector.forward = lambda batch: (logits, offsets)  # type: ignore[method-assign]
    found = detector.detect({}, max_boxes=10, min_score=0.5)[0]
    overlaps = bev_iou(rectangles_velo(found.boxes_velo), rectangles_velo(boxes))
    assert len(found.scores) == 2
    assert overlaps.max(axis=0).min() > 0.999
    np.testing.assert_allclose(np.sort(found.boxes_velo[:, 2]), np.sort(boxes[:, 2]), atol=1e-4)


def test_the_codes_x_shift_is_an_option() -> None:
    plain, shifted = make(), make("detector.x_shift=0.1")
    shifted.load_state_dict(plain.state_dict())
    batch = {"occupied": torch.tensor([[0, 5, 50, 50]]), "size": torch.tensor(1)}
    a, b = (d.eval().detect(batch, 3, 0.0)[0].boxes_velo for d in (plain, shifted))
    np.testing.assert_allclose(b - a, np.array([[0.1, 0, 0, 0, 0, 0, 0]] * 3), atol=1e-6)
