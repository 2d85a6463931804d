"""Clouds of every form: what is read, and what is refused as looking like another form."""

import io
import re
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import ConfigError, DataError
from fl3d.data.cloud_forms import CloudFormat
from fl3d.data.clouds import find_cloud, read_cloud
from fl3d.data.pcd import unpack_lzf

Array = np.ndarray


def scan(n: int = 4000) -> Array:
    """A cloud as a spinning sensor gives it: (n, 4), one ring after another, x y z and a reflectance of 0 to 1."""
    angle = np.linspace(0, 20 * np.pi, n)
    ring = np.repeat(np.arange(10), n // 10)
    distance = 5 + 3 * ring + np.sin(angle)
    x, y = distance * np.cos(angle), distance * np.sin(angle)
    z = -1.7 + 0.1 * ring
    return np.column_stack([x, y, z, (1 + np.sin(3 * angle)) / 2]).astype("<f4")


def write(folder: Path, rows: Array, name: str = "000000.bin") -> Path:
    path = folder / name
    path.write_bytes(rows.tobytes())
    return path


def npy(rows: Array) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, rows)
    return buffer.getvalue()


RING = np.repeat(np.arange(10), 400).astype("<f4")
TIME = np.linspace(0, 0.1, 4000).astype("<f4")


def test_kittis_form_is_read_bit_by_bit(tmp_path: Path) -> None:
    cloud = read_cloud(write(tmp_path, scan()))
    np.testing.assert_array_equal(cloud.points_velo, scan())
    assert cloud.points_velo.dtype == np.float32
    assert cloud.dropped == 0


def test_an_empty_file_has_no_points(tmp_path: Path) -> None:
    assert read_cloud(write(tmp_path, np.zeros(0))).points_velo.shape == (0, 4)


@pytest.mark.parametrize(
    "change",
    [
        [1, 1, 1, 255],  # reflectances of 0 to 255
        [1000, 1000, 1000, 1],  # millimetres
        [1, 1, 1, 0],
    ],
)
def test_what_is_odd_but_possible_is_read(tmp_path: Path, change: list[float]) -> None:
    rows = (scan() * change).astype("<f4")
    np.testing.assert_array_equal(read_cloud(write(tmp_path, rows)).points_velo, rows)


def test_coordinates_of_a_map_are_read(tmp_path: Path) -> None:
    rows = (scan() + np.array([5e5, 5.8e6, 0, 0])).astype("<f4")
    assert len(read_cloud(write(tmp_path, rows)).points_velo) == 4000


def test_points_in_any_order_are_read(tmp_path: Path) -> None:
    rows = scan()[np.random.default_rng(0).permutation(4000)]
    assert len(read_cloud(write(tmp_path, rows)).points_velo) == 4000


@pytest.mark.parametrize(
    ("rows", "name", "keys"),
    [
        (scan().astype("<f8"), "float64", "data.cloud.dtype=float64"),
        (scan()[:, :3], "3 columns", "data.cloud.columns=3"),
        (np.column_stack([scan(), RING]), "5 columns", "data.cloud.columns=5"),
        (np.column_stack([scan(), RING, TIME]), "6 columns", "data.cloud.columns=6"),
        (
            np.column_stack([scan(), RING]).astype("<f8"),
            "5 columns of float64",
            "data.cloud.columns=5 data.cloud.dtype=float64",
        ),
        (
            np.column_stack([scan() * np.array([1, 1, 1, 255]), RING]).astype("<f4"),
            "5 columns",
            "data.cloud.columns=5",
        ),
        # x, y and z are all above 0: no reflectance is below 0 whatever the columns
        (
            np.column_stack([scan() + np.array([99, 99, 9, 0]), RING]).astype("<f4"),
            "5 columns",
            "data.cloud.columns=5",
        ),
        (scan()[:3999, :3], "3 columns", "data.cloud.columns=3"),  # no whole number of 16 bytes
    ],
)
def test_another_form_is_refused_with_the_keys_that_read_it(
    tmp_path: Path, rows: Array, name: str, keys: str
) -> None:
    path = write(tmp_path, np.ascontiguousarray(rows))
    with pytest.raises(DataError) as caught:
        read_cloud(path)
    assert re.fullmatch(
        rf".*000000\.bin: looks like {name}( \(.*\))?: give {re.escape(keys)}", str(caught.value)
    )
    told = dict(word.split("=") for word in keys.split())
    columns = int(told.get("data.cloud.columns", 4))
    form = CloudFormat(columns, told.get("data.cloud.dtype", "float32"))
    expected = np.zeros((len(rows), 4), dtype=np.float32)
    expected[:, : min(columns, 4)] = rows[:, :4]
    np.testing.assert_array_equal(read_cloud(path, form).points_velo, expected)


def test_what_is_told_is_read_as_told(tmp_path: Path) -> None:
    path = write(tmp_path, np.column_stack([scan(), RING]))
    assert len(read_cloud(path, CloudFormat(4, "float32")).points_velo) == 5000


def test_one_key_leaves_the_other_to_be_checked(tmp_path: Path) -> None:
    path = write(tmp_path, np.column_stack([scan(), RING]).astype("<f8"))
    for form, key in (
        (CloudFormat(columns=5), "data.cloud.dtype=float64"),
        (CloudFormat(dtype="float64"), "data.cloud.columns=5"),
    ):
        with pytest.raises(DataError, match=f": give {key}$"):
            read_cloud(path, form)


def test_a_cloud_that_looks_like_nothing_says_how_to_read_it_all_the_same(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).uniform(-1, 1, (100, 4)).astype("<f4")
    path = write(tmp_path, rows)
    with pytest.raises(DataError, match=r"% of the reflectances are below 0\. .*To read it so all"):
        read_cloud(path)
    form = CloudFormat(4, "float32")
    np.testing.assert_array_equal(read_cloud(path, form).points_velo, rows)


@pytest.mark.parametrize(
    ("form", "message"),
    [
        (None, "63988 bytes are not a whole number of points of 4 columns of float32 (16 bytes)"),
        (
            CloudFormat(5, "float64"),
            "63988 bytes are not a whole number of points of 5 columns of float64 (40 bytes)",
        ),
    ],
)
def test_a_cloud_that_is_cut_off_names_bytes_and_columns(
    tmp_path: Path, form: CloudFormat | None, message: str
) -> None:
    path = tmp_path / "000000.bin"
    path.write_bytes(scan().tobytes()[:-12])
    with pytest.raises(DataError, match=re.escape(message)):
        read_cloud(path, form)


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path: Path) -> None:
    rows = scan()
    rows[7, 0], rows[8, 2], rows[9, 3], rows[10] = np.nan, np.inf, -np.inf, np.nan
    cloud = read_cloud(write(tmp_path, rows))
    assert cloud.dropped == 4
    np.testing.assert_array_equal(cloud.points_velo, np.delete(rows, [7, 8, 9, 10], axis=0))


def test_the_reflectance_is_divided(tmp_path: Path) -> None:
    rows = (scan() * np.array([1, 1, 1, 255])).astype("<f4")
    form = CloudFormat(reflectance_scale=255)
    for path in (write(tmp_path, rows), tmp_path / "a.npy"):
        path.write_bytes(npy(rows) if path.suffix == ".npy" else rows.tobytes())
        points = read_cloud(path, form).points_velo
        np.testing.assert_allclose(points, scan(), atol=1e-6)
        assert points.dtype == np.float32


@pytest.mark.parametrize("name", ["000000.bin", "000000.npy"])
@pytest.mark.parametrize("kind", ["<f2", "<f4", "<f8", ">f4"])
@pytest.mark.parametrize("columns", [3, 4, 6])
def test_numpys_files_are_known_by_their_first_bytes(
    tmp_path: Path, name: str, kind: str, columns: int
) -> None:
    rows = np.column_stack([scan(), RING, TIME])[:, :columns].astype(kind)
    path = tmp_path / name
    path.write_bytes(npy(rows))
    expected = np.zeros((4000, 4), dtype=np.float32)
    expected[:, : min(columns, 4)] = rows[:, :4]
    np.testing.assert_array_equal(read_cloud(path).points_velo, expected)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy(np.zeros(8)), "is a NumPy array of float64 and shape (8,), but points need (N, 3)"),
        (npy(np.zeros((8, 2))), "is a NumPy array of float64 and shape (8, 2), but points need"),
        (npy(np.zeros((8, 4)))[:-1], "is a NumPy file that cannot be read"),
        (npy(np.zeros((8, 4), dtype="U3")), "is a NumPy array of <U3 and shape (8, 4)"),
        (b"ply\nformat ascii 1.0\n", "is a PLY file, not a cloud"),
        (b"PK\x03\x04" + bytes(60), "is an archive, such as NumPy's npz, not a cloud"),
        (b"1.0 2.0 3.0 0.5\n" * 9, "is text ('1.0 2.0 3.0 0.5'), not a cloud"),
        (
            b"version https://git-lfs.github.com/spec/v1\n",
            "is text ('version https://git-lfs.github",
        ),
    ],
)
def test_other_files_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "000000.bin"
    path.write_bytes(content)
    with pytest.raises(DataError, match=re.escape(message)):
        read_cloud(path)


@pytest.mark.parametrize("kind", ["<i2", "<i4", ">f4"])
def test_whole_numbers_and_other_byte_orders_are_not_taken_for_floats(
    tmp_path: Path, kind: str
) -> None:
    scale = 1 if kind == ">f4" else 100
    path = write(tmp_path, (scan() * scale).astype(kind))
    with pytest.raises(DataError, match="does not look like points of 4 columns of float32: "):
        read_cloud(path)


def test_an_array_with_named_columns_is_read_by_their_names(tmp_path: Path) -> None:
    kinds = [("Intensity", "<u2"), ("z", "<f4"), ("y", "<f4"), ("x", "<f8"), ("ring", "<i4")]
    rows = np.array([(51, 3, 2, 1, 7), (102, 6, 5, 4, 8)], dtype=kinds)
    np.save(tmp_path / "a.npy", rows)
    found = read_cloud(tmp_path / "a.npy", CloudFormat(reflectance_scale=255)).points_velo
    np.testing.assert_allclose(found, [[1, 2, 3, 0.2], [4, 5, 6, 0.4]])
    np.save(tmp_path / "b.npy", np.zeros(2, dtype=[("x", "<f4"), ("y", "<f4")]))
    with pytest.raises(DataError, match=r"without a column z \(found: x, y\)"):
        read_cloud(tmp_path / "b.npy")


def test_a_transposed_array_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((4, 17), dtype=np.float32))
    with pytest.raises(DataError, match=r"shape \(4, 17\).*transposed\?"):
        read_cloud(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.zeros((4, 5), dtype=np.float32))
    assert len(read_cloud(tmp_path / "b.npy").points_velo) == 4


def test_a_folder_and_a_missing_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=": is a folder, but a file is needed"):
        read_cloud(tmp_path)
    with pytest.raises(DataError, match=r"a\.bin: no such file"):
        read_cloud(tmp_path / "a.bin")


def test_the_first_ending_that_is_there_is_taken(tmp_path: Path) -> None:
    assert find_cloud(tmp_path, "7").name == "7.bin"
    for ending in ("pcd", "npy", "bin"):
        (tmp_path / f"7.{ending}").touch()
        assert find_cloud(tmp_path, "7").name == f"7.{ending}"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"columns": 2}, "data.cloud.columns: 2, but it is null, 3, 4, 5 or more"),
        ({"columns": "four"}, "data.cloud.columns: four, but"),
        ({"columns": True}, "data.cloud.columns: True, but"),
        ({"dtype": "float16"}, "data.cloud.dtype: no choice 'float16'. Possible: null, float32"),
        ({"reflectance_scale": 0}, "data.cloud.reflectance_scale: 0, but it is a number above 0"),
        ({"reflectance_scale": float("nan")}, "data.cloud.reflectance_scale: nan, but"),
    ],
)
def test_values_that_cannot_be_are_named(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        CloudFormat(**values)  # type: ignore[arg-type]


def head(fields: str, sizes: str, kinds: str, counts: str, points: int, data: str) -> bytes:
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\n"
        f"TYPE {kinds}\nCOUNT {counts}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {points}\nDATA {data}\n"
    ).encode()


XYZI = ("x y z intensity", "4 4 4 4", "F F F F", "1 1 1 1")
THREE = np.array([[1, 2, 3, 0.25], [-4, 5.5, 6, 0.5], [7, 8, -9, 0.75]], dtype="<f4")
TEXT = b"".join(b" ".join(str(v).encode() for v in row) + b"\n" for row in THREE.tolist())
# By hand: a byte below 32 says how many literal bytes follow, less 1. 48 bytes are 32 and 16.
COLUMNS = THREE.T.tobytes()
PACKED = bytes([31]) + COLUMNS[:32] + bytes([15]) + COLUMNS[32:]
SIZES = np.array([len(PACKED), 48], dtype="<u4").tobytes()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"# .PCD v0.7 - Point Cloud Data file format\n", b""),
        (b"# .PCD v0.7", b"# made by a tool\r\n\n# of mine"),
        (b"VERSION 0.7\n", b""),
        (b"HEIGHT 1\n", b""),
        (b"COUNT 1 1 1 1\n", b""),
        (b"\n", b"\r\n"),
        (b"intensity", b"Reflectance"),
    ],
)
def test_a_header_may_be_shorter_or_longer(tmp_path: Path, old: bytes, new: bytes) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(head(*XYZI, 3, "binary").replace(old, new) + THREE.tobytes())
    np.testing.assert_array_equal(read_cloud(path).points_velo, THREE)


@pytest.mark.parametrize("name", ["a.pcd", "a.bin"])
@pytest.mark.parametrize(
    ("data", "body"),
    [("ascii", TEXT), ("binary", THREE.tobytes()), ("binary_compressed", SIZES + PACKED)],
)
def test_pcd_of_all_three_kinds_is_read(tmp_path: Path, name: str, data: str, body: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(head(*XYZI, 3, data) + body)
    np.testing.assert_array_equal(read_cloud(path).points_velo, THREE)


def test_fields_of_pcd_are_found_by_name_among_others(tmp_path: Path) -> None:
    kind = np.dtype([("ring", "<u2"), ("z", "<f8"), ("rgb", "<f4", 2), ("x", "<f4"), ("y", "<f4")])
    rows = np.zeros(2, dtype=kind)
    rows["x"], rows["y"], rows["z"], rows["ring"] = [1, 2], [3, 4], [5, np.nan], 9
    path = tmp_path / "a.pcd"
    path.write_bytes(
        head("ring z rgb x y", "2 8 4 4 4", "U F F F F", "1 1 2 1 1", 2, "binary") + rows.tobytes()
    )
    cloud = read_cloud(path)
    assert cloud.points_velo.tolist() == [[1, 3, 5, 0]]
    assert cloud.dropped == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (head(*XYZI, 3, "binary") + THREE.tobytes()[:-4], "3 points cannot be read (48 bytes, fou"),
        (head(*XYZI, 3, "ascii") + TEXT[:-6], "cannot be read (4 numbers each, found 11)"),
        (head(*XYZI, 3, "ascii") + TEXT + b"1", "cannot be read (4 numbers each, found 13)"),
        (head(*XYZI, 3, "binary_compressed") + SIZES + PACKED[:-1], "cannot be read (58 bytes"),
        (
            head(*XYZI, 3, "binary_compressed") + SIZES + b"\xff" * len(PACKED),
            "its compressed bytes are broken",
        ),
        (head(*XYZI, 3, "zipped"), "DATA is zipped, not ascii, binary or binary_compressed"),
        (head("x y", "4 4", "F F", "1 1", 0, "ascii"), "no field z (found: x, y)"),
        (head("x y z", "4 4", "F F", "1 1 1", 0, "ascii"), "header cannot be read"),
        (head(*XYZI, 3, "ascii").replace(b"DATA ascii", b""), "its header has no line DATA"),
    ],
)
def test_a_broken_pcd_is_named(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(content)
    with pytest.raises(DataError, match=re.escape(message)):
        read_cloud(path)


@pytest.mark.parametrize(
    ("packed", "plain"),
    [
        (b"\x02abc", b"abc"),
        (b"\x00a\x20\x00", b"aaaa"),  # a copy of 1 + 2 bytes from 1 back, which overlaps itself
        (b"\x02abc\x40\x02\x00!", b"abcabca!"),  # of 2 + 2 from 3 back, and a literal
        (b"\x00a\xe0\x05\x00", b"a" * 15),  # of 7 + 5 + 2
        (b"\x1f" + b"b" * 32 + b"\x1f" + b"c" * 32 + b"\x20\x3f", b"b" * 32 + b"c" * 32 + b"bbb"),
    ],
)
def test_lzf_by_hand(packed: bytes, plain: bytes) -> None:
    found = np.zeros(len(plain), dtype=np.uint8)
    assert unpack_lzf(np.frombuffer(packed, dtype=np.uint8), found) == len(plain)
    assert found.tobytes() == plain


@pytest.mark.parametrize(
    "packed", [b"\x05ab", b"\x20\x00", b"\x00a\xe0", b"\x00a\x20", b"\x1f" * 40]
)
def test_broken_lzf_ends_in_minus_one(packed: bytes) -> None:
    found = np.zeros(20, dtype=np.uint8)
    assert unpack_lzf(np.frombuffer(packed, dtype=np.uint8), found) == -1


def forms(rows: Array) -> dict[str, Array]:
    """A cloud as others write it, by what it looks like."""
    n = len(rows)
    ring, time = np.linspace(0, 63, n).round(), np.linspace(0, 0.1, n)
    return {
        "float64": rows.astype("<f8"),
        "3 columns": rows[:, :3].astype("<f4"),
        "5 columns": np.column_stack([rows, ring]).astype("<f4"),
        "6 columns": np.column_stack([rows, ring, time]).astype("<f4"),
    }


def test_all_real_clouds_are_told_from_other_forms(kitti_sample: Path, tmp_path: Path) -> None:
    """None is read as if it were right, and none that is right is refused."""
    files = sorted((kitti_sample / "training" / "velodyne").glob("*.bin"))
    assert len(files) == 32
    for file in files:
        rows = np.fromfile(file, dtype="<f4").reshape(-1, 4)
        for scaled in (rows, rows * np.array([1, 1, 1, 255], dtype="<f4")):
            for name, other in forms(scaled).items():
                with pytest.raises(DataError, match=f": looks like {name}( \\(.*\\))?: give "):
                    read_cloud(write(tmp_path, np.ascontiguousarray(other)))
            shifted = (scaled + np.array([5e5, 5.8e6, 0, 0])).astype("<f4")
            small = (scaled * np.array([1000, 1000, 1000, 1])).astype("<f4")
            for right in (scaled, shifted, small):
                read = read_cloud(write(tmp_path, right)).points_velo
                np.testing.assert_array_equal(read, right)
