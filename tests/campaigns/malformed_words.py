"""Malformed words and YAMLs; of each word what the answer must name. SMALL stands for a small sweep's words."""

from __future__ import annotations

# Of what lies somewhere, or is to be imported, the answer may name that.
PLACES = ("data.root", "data.train_split", "store.uri", "hydra.sweeper.sampler._target_")


def _each(key: str, values: list[str], multirun: bool = False, before: str = "") -> list[tuple]:  # type: ignore[type-arg]
    first = ["-m"] if multirun else []
    last = key.lstrip("+~").rpartition(".")[2]
    return [
        (
            [*first, "SMALL", *before.split(), f"{key}={value}"],
            (last, value) if key in PLACES else last,
        )
        for value in values
    ]


OPTUNA = "hydra/sweeper=optuna loss.gamma=interval(0,5)"
UNTIL = "hydra/sweeper=until_decided loss.gamma=0,2"

WORDS: list[tuple] = [  # type: ignore[type-arg]
    *_each("detector", ["fcn4d", "null", "3", "glob(zz*)"]),
    *_each("detecto", ["fcn3d"]),
    *_each("loss", ["focl", "3"]),
    *_each("loss.gamma", ["abc", "nan", "inf", "[1,2]", "{a:1}", "null", "''", "true"]),
    *_each("loss.gama", ["2"]),
    *_each("optimizer.lr", ["abc", "-1", "nan", "null", "[1]"]),
    *_each("seed", ["abc", "1.5", "-1", "null", "[1]", "99999999999999999999999"]),
    *_each("schedule.batch_size", ["0", "-1", "1.5", "abc", "null"]),
    *_each("schedule.frames_per_epoch", ["0", "-4", "abc", "2.5"]),
    *_each("schedule.epochs.warmup", ["-1", "1.5", "abc", "null"]),
    *_each("schedule.epochs", ["3", "[1,2]", "abc"]),
    *_each("schedule.stages", ["null", "3"]),
    *_each("schedule.checkpoint_every", ["0", "-1", "abc"]),
    *_each("schedule.clip", ["abc", "-1"]),
    *_each("profile", ["huge", "null"]),
    *_each("data", ["nowhere"]),
    *_each("data.root", ["/nonexistent/folder", "null", "3"]),
    *_each("data.train_split", ["nothere", "null"]),
    *_each("data.train_frames", ["0", "-1", "abc", "1.5"]),
    *_each("data.cache_frames", ["-1", "abc"]),
    *_each("protocol", ["nokitti"]),
    *_each("protocol.score_threshold", ["abc", "nan"]),
    *_each("protocol.nms_kind", ["foo"]),
    *_each("protocol.nms_iou", ["abc", "-3", "nan"]),
    *_each("protocol.max_detections", ["0", "-1", "abc"]),
    *_each("protocol.ignore_beyond", ["abc", "[1,2]", "[a,b,c,d]"]),
    *_each("detections.max_boxes", ["0", "-5", "abc"]),
    *_each("detections.min_score", ["abc", "nan"]),
    *_each("device", ["gpu", "cuda:99", "3"]),
    *_each("precision", ["float12", "null"]),
    *_each("workers", ["-1", "abc"]),
    *_each("augment", ["foo", "3"]),
    *_each("sweep.primary", ["foo", "3d/foo", "null"]),
    *_each("sweep.margin", ["-1", "abc", "nan"]),
    *_each("sweep.factor", ["foo", "[foo,bar]"], multirun=True, before="loss.gamma=0,2"),
    *_each("sweep.baseline", ["99"], multirun=True, before="loss.gamma=0,2"),
    *_each("sweep.groups", ["foo"], multirun=True, before="loss.gamma=0,2"),
    *_each("sweep.tables", ["[foo.bar]", "3"], multirun=True, before="loss.gamma=0,2"),
    *_each(
        "sweep.name", ["a/b", "../../evil", "x" * 300, "''"], multirun=True, before="loss.gamma=0,2"
    ),
    *_each("selection.stages", ["foo"]),
    *_each("store.keep_every", ["abc", "-1", "1.5"]),
    *_each("store.uri", ["foo://x", "http://127.0.0.1:1", "postgresql://nobody@127.0.0.1:1/x"]),
    *_each("store.root", ["/proc/nowhere", "/dev/null/x"]),
    *_each("results", ["/proc/nowhere", "/dev/null/x"]),
    *_each("hydra/launcher", ["foo", "basic"]),
    *_each("hydra/sweeper", ["foo", "basic"], multirun=True, before="loss.gamma=0,2"),
    *_each(
        "hydra.launcher.slots",
        ["-1", "abc", "0", "1.5"],
        multirun=True,
        before="hydra/launcher=local loss.gamma=0,2",
    ),
    *_each("hydra.sweeper.n_trials", ["abc", "null", "-1"], multirun=True, before=OPTUNA),
    *_each("hydra.sweeper.objectives", ["[foo]", "[]", "3"], multirun=True, before=OPTUNA),
    *_each("hydra.sweeper.rule", ["foo"], multirun=True, before=OPTUNA),
    *_each("hydra.sweeper.enqueue", ["[{foo:1}]", "3"], multirun=True, before=OPTUNA),
    *_each("hydra.sweeper.storage", ["foo://x"], multirun=True, before=OPTUNA),
    *_each(
        "hydra.sweeper.sampler._target_", ["no.Such", "os.getcwd"], multirun=True, before=OPTUNA
    ),
    *_each("hydra.sweeper.foo", ["1"], multirun=True, before=OPTUNA),
    *_each(
        "loss.gamma",
        ["interval(5,0)", "interval(a,b)", "range(0,0)", "choice()"],
        multirun=True,
        before="hydra/sweeper=optuna",
    ),
    *_each("loss.gamma", ["range(0,0)", "choice()", "interval(0,1)", "0,,1"], multirun=True),
    *_each("hydra.sweeper.most", ["1", "abc", "null"], multirun=True, before=UNTIL),
    *_each("hydra.sweeper.first", ["0", "abc"], multirun=True, before=UNTIL),
    *_each("hydra.sweeper.step", ["0", "-1", "abc"], multirun=True, before=UNTIL),
    *_each("hydra.sweeper.hours", ["abc", "-1"], multirun=True, before=UNTIL),
    *_each("seeds", ["0", "-1", "abc", "1.5"], multirun=True, before="loss.gamma=0,2"),
    *_each("seeds", ["3"]),
    *_each("+foo", ["1"]),
    *_each("+foo", ["1,2"], multirun=True),
    *_each("+seeds", ["1,2,3"], multirun=True),
    (["-m", "SMALL", "~foo"], "foo"),
    (["SMALL", "loss.gamma=1,2"], "gamma"),
    (["SMALL", "loss.gamma=${foo.bar}"], ("foo", "gamma")),
    (["SMALL", "loss.gamma=${"], "gamma"),
    (["SMALL", "loss.gamma={a"], "gamma"),
    (["SMALL", "=3"], "=3"),
    (["SMALL", "loss..gamma=3"], "gamma"),
    (["SMALL", "--foo"], "--foo"),
    (["SMALL", "--config-name", "nothing"], "--config-name"),
    (["SMALL", "--config-dir", "/nonexistent"], "/nonexistent"),
    (["SMALL", "--cfg", "foo"], "foo"),
    (["-m", "+sweep=nothing"], "nothing"),
    (["plann"], "plan"),
    (["plan", "+sweep=nothing"], "nothing"),
    (["plan", "--spread", "abc"], "spread"),
    (["gains", "SMALL", "loss.gamma=0,2"], ()),
    (["gains"], "gains"),
    (["tables", "SMALL", "sweep.name=nothing"], ("nothing",)),
    (["why", "SMALL", "III"], ()),
    (["why", "III", "gamma=2", "4d/moderate"], ()),
    (["verify", "+sweep=nothing"], "nothing"),
    (["rescore", "SMALL", "sweep.name=nothing"], ()),
    (["clean", "store.root=/nonexistent"], "/nonexistent"),
    (["clean", "store.keep_every=abc"], "store.keep_every"),
    (["evaluate", "/nonexistent", "/nonexistent"], "/nonexistent"),
    (
        [
            "evaluate",
            "{shared}/data/training/label_2",
            "{shared}/exp/0/seed0/epoch_5/data",
            "--protocol",
            "foo",
        ],
        "foo",
    ),
    (
        [
            "evaluate",
            "{shared}/data/training/label_2",
            "{shared}/exp/0/seed0/epoch_5/data",
            "--split",
            "/nonexistent",
        ],
        "/nonexistent",
    ),
    (
        ["compare", "{shared}/data/training/label_2", "a=/nonexistent", "b=/nonexistent"],
        "/nonexistent",
    ),
    (["compare", "{shared}/data/training/label_2"], ()),
    (["check", "/nonexistent"], "/nonexistent"),
    (["check", "{shared}/exp"], "exp"),
    (["predict", "/nonexistent", "/nonexistent"], "/nonexistent"),
    (["simulate", "{work}/sim", "--frames", "abc"], "frames"),
    (["simulate", "{work}/sim", "--frames", "-3"], "frames"),
    (["simulate", "/proc/nowhere", "--frames", "2"], "/proc/nowhere"),
    (["stage", "/nonexistent"], "/nonexistent"),
    (["import", "/nonexistent/{level}", "sweep.name=x"], "/nonexistent"),
    (["import", "/nonexistent/{lvl}", "sweep.name=x"], "lvl"),
    (["import", "/nonexistent.csv", "sweep.name=x"], "/nonexistent.csv"),
    (["publish", "foo=bar"], "foo"),
]

HEAD = "# @package _global_\n"
CONFIGS: list[tuple[str, str | bytes]] = [
    ("sweep", HEAD + "sweep:\n\tname: tabs\n"),
    ("sweep", HEAD + "sweep: {name: odd\n"),
    ("sweep", HEAD + "- a\n- list\n"),
    ("sweep", HEAD + "just text\n"),
    ("sweep", b"\xff\xfe\x00\x01binary\x00"),
    ("sweep", HEAD + "sweep: {name: odd}\nsweep: {name: twice}\nfoo: [\n"),
    ("sweep", HEAD + "sweep: {name: odd}\nhydra: {sweeper: {params: [1, 2]}}\n"),
    ("sweep", HEAD + "sweep: {name: odd}\nhydra: {sweeper: {params: {loss.gama: '0,1'}}}\n"),
    ("sweep", HEAD + "sweep: {name: odd}\nhydra: {sweeper: {params: {loss.gamma: '0,abc'}}}\n"),
    ("sweep", HEAD + "sweep: {name: odd}\nhydra: {sweeper: {params: 3}}\n"),
    ("sweep", HEAD + "sweep: {name: odd}\nhydra: {sweeper: {_target_: no.Such}}\n"),
    (
        "sweep",
        HEAD + "sweep: {name: odd, primry: 3d}\nhydra: {sweeper: {params: {loss.gamma: '0,1'}}}\n",
    ),
    ("sweep", HEAD + "sweep: 3\n"),
    ("sweep", HEAD + "sweep: {name: null}\nhydra: {sweeper: {params: {loss.gamma: '0,1'}}}\n"),
    (
        "sweep",
        HEAD
        + "sweep: {name: '${nothing.there}'}\nhydra: {sweeper: {params: {loss.gamma: '0,1'}}}\n",
    ),
    (
        "sweep",
        HEAD + "sweep: {name: '${sweep.name}'}\nhydra: {sweeper: {params: {loss.gamma: '0,1'}}}\n",
    ),
    ("sweep", HEAD + "defaults: [nothing_there]\nsweep: {name: odd}\n"),
    ("sweep", HEAD + "defaults: [override /detector: nothing]\nsweep: {name: odd}\n"),
    ("sweep", HEAD + "defaults: 3\nsweep: {name: odd}\n"),
    (
        "sweep",
        HEAD
        + "sweep: {name: odd, after: nothing}\nhydra: {sweeper: {params: {loss.gamma: '0,1'}}}\n",
    ),
    (
        "sweep",
        HEAD
        + "sweep: {name: odd, tables: [no.table]}\nhydra: {sweeper: {params: {loss.gamma: '0,1'}}}\n",
    ),
    ("detector", HEAD + "detector: {_target_: no.Such}\n"),
    ("detector", HEAD + "detector: {}\n"),
    ("detector", HEAD + "detector: 3\n"),
    ("detector", HEAD + "detector: {_target_: fl3d.detectors.fcn3d.FCN3D, foo: 1}\n"),
    ("detector", HEAD + "detector: {_target_: os.getcwd}\n"),
    ("detector", HEAD + "defaults: [command]\ndetector: {name: x, run: 3, program: {folder: .}}\n"),
    (
        "detector",
        HEAD
        + "defaults: [command]\ndetector: {name: x, run: ['{nothing}'], program: {folder: .}}\n",
    ),
    (
        "detector",
        HEAD
        + "defaults: [command]\ndetector: {name: x, run: [ls], program: {folder: /nonexistent}}\n",
    ),
    (
        "detector",
        HEAD
        + "defaults: [command]\ndetector: {name: x, run: [ls], program: {folder: ., files: [nothing.py]}}\n",
    ),
    (
        "detector",
        HEAD
        + "defaults: [command]\ndetector: {name: x, run: [ls], progress: '(', program: {folder: .}}\n",
    ),
]
