"""`styl3r stylize --each`: one scene a style, from photos that are read once."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from styl3r_cli.formats import read_scene
from styl3r_cli.pipeline import Stylizer

Run = Callable[..., tuple[int, bytes, str]]


@pytest.fixture
def styles(tmp_path: Path, make_picture: Callable[..., Path]) -> list[Path]:
    return [make_picture(tmp_path / f"style {n}.png", seed=90 + n) for n in range(3)]


def options(styles: list[Path]) -> list[object]:
    return [part for style in styles for part in ("--style", style)]


def test_each_style_has_the_scene_that_it_has_alone(
    run: Run,
    photos: list[Path],
    styles: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    encoded: list[int] = []
    encode = Stylizer.encode
    monkeypatch.setattr(
        Stylizer, "encode", lambda self, given: encoded.append(1) or encode(self, given)
    )
    folder = tmp_path / "new" / "folder"
    command = ("stylize", *photos, *options(styles), "--each", "--json")
    cameras = tmp_path / "cameras.json"
    code, out, err = run(
        *command, "-o", folder / "{style}.ply", "--cameras-out", cameras, "--preview",
        folder / "{style} sheet.png",
    )  # fmt: skip
    assert (code, encoded) == (0, [1]), err
    names = [f"style {n}{end}" for n in range(3) for end in (" sheet.png", ".ply")]
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    assert cameras.exists()
    told = json.loads(out)
    reports, shared = told["scenes"], told["shared_timings"]
    assert set(shared) == {"photos", "model", "structure", "cameras", "total"}
    assert [report["styles"][0]["path"] for report in reports] == [str(s) for s in styles]
    for style, report in zip(styles, reports, strict=True):
        alone = tmp_path / "alone.ply"
        assert run("stylize", *photos, "--style", style, "-o", alone)[0] == 0
        assert (folder / f"{style.stem}.ply").read_bytes() == alone.read_bytes()
        assert report["outputs"]["scene"] == str(folder / f"{style.stem}.ply")
    later, first = reports[1]["timings"], reports[0]["timings"]
    assert later["structure"] == later["photos"] == 0
    assert 0 < later["appearance"] < later["total"]
    assert first["total"] > 0


def test_styles_of_one_name_do_not_replace_each_other(
    run: Run, photos: list[Path], make_picture: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "other").mkdir()
    twins = [make_picture(tmp_path / d / "art.png", seed=n) for n, d in enumerate((".", "other"))]
    command = ("stylize", *photos, *options(twins), "--each", "--all")
    assert run(*command, "-o", tmp_path / "{style}.ply")[0] == 0
    first, second = (read_scene(tmp_path / f"{n}.ply").gaussians for n in ("art", "art-2"))
    assert (first.means == second.means).all()
    assert (first.colours != second.colours).any()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("-o", "scene.ply"), "{style}"),
        (("-o", "-"), "-o DIR/{style}.ply"),
        (("-o", "{style}.ply", "--video", "swing.mp4"), "--video swing.mp4"),
        (("-o", "{style}.txt"), "{style}.txt"),
        (("-o", "of_{style}/{style}.ply"), "not in a folder's"),
    ],
)
def test_outputs_without_a_place_for_the_style_are_refused(
    run: Run,
    photos: list[Path],
    styles: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    given: tuple[str, ...],
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    code, _, err = run("stylize", *photos, *options(styles), "--each", *given)
    assert code == 2
    assert told in err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("option", ["-o", "--video", "--preview", "--cameras-out"])
def test_a_place_for_the_style_without_each_is_refused(
    run: Run, photos: list[Path], styles: list[Path], tmp_path: Path, option: str
) -> None:
    suffix = {"--video": ".mp4", "--preview": ".png", "--cameras-out": ".json"}.get(option, ".ply")
    outputs = {"-o": tmp_path / "scene.ply", option: tmp_path / f"{{style}}{suffix}"}
    words = [word for pair in outputs.items() for word in pair]
    code, _, err = run("stylize", *photos, *options(styles), *words)
    assert (code, err.count("\n")) == (2, 1)
    assert f"{{style}}{suffix}: {{style}} is for --each" in err
    assert not (tmp_path / f"{{style}}{suffix}").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere they are one file")
def test_names_that_some_file_systems_take_for_one_do_not_replace_each_other(
    run: Run, photos: list[Path], make_picture: Callable[..., Path], tmp_path: Path
) -> None:
    """Case is no difference to macOS and Windows; how an accent is written is none to macOS."""
    names = ["Art", "other/art", "other/\u00e9", "other/e\u0301"]
    (tmp_path / "other").mkdir()
    twins = [make_picture(tmp_path / f"{name}.png", seed=n) for n, name in enumerate(names)]
    command = ("stylize", *photos, *options(twins), "--each", "--all", "--quality", "draft")
    assert run(*command, "-o", tmp_path / "out" / "{style}.ply")[0] == 0
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert made == {"Art.ply", "art-2.ply", "\u00e9.ply", "e\u0301-2.ply"}


@pytest.mark.parametrize(
    ("weights", "more", "code", "words"),
    [
        ("", {"--cameras-out": "{style}.json"}, 2, "one file for all styles"),
        ("=0", {}, 2, "weights are for a blend"),
        ("=2", {}, 2, "weights are for a blend"),
        ("", {"-o": "new/" + "x" * 250 + "{style}.ply"}, 6, "File name too long"),
    ],
)
def test_batches_that_could_not_end_well_are_not_begun(
    run: Run,
    photos: list[Path],
    styles: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    weights: str,
    more: dict[str, str],
    code: int,
    words: str,
) -> None:
    monkeypatch.setattr(Stylizer, "__init__", lambda *_, **__: pytest.fail("work was begun"))
    places = {"-o": "new/{style}.ply", **more}
    named = [part for key, name in places.items() for part in (key, tmp_path / name)]
    last = ("--style", f"{styles[2]}{weights}")
    found, out, err = run("stylize", *photos, *options(styles[:2]), *last, "--each", *named)
    assert (found, out, err.count("\n")) == (code, b"", 1)
    assert words in err
    assert not (tmp_path / "new").exists()


def test_a_style_that_cannot_be_used_does_not_stop_the_others(
    run: Run, photos: list[Path], styles: list[Path], tmp_path: Path
) -> None:
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no picture")
    folder = tmp_path / "out"
    command = ("stylize", *photos, "--each", "-o", folder / "{style}.ply", "--json")
    given = [broken, styles[0], styles[2]]
    cameras = tmp_path / "cameras.json"
    code, out, err = run(*command, *options(given), "--cameras-out", cameras)
    assert (code, cameras.exists()) == (5, True)
    assert sorted(path.name for path in folder.iterdir()) == ["style 0.ply", "style 2.ply"]
    told = json.loads(out)["scenes"]
    assert [each["styles"][0]["path"] for each in told] == [str(styles[0]), str(styles[2])]
    (line,) = [line for line in err.splitlines() if "error" in line]
    assert "1 of 3 styles" in line
    assert str(broken) in line


def test_no_folder_is_made_for_scenes_that_never_come(
    run: Run, photos: list[Path], styles: list[Path], tmp_path: Path
) -> None:
    photos[0].write_bytes(b"no picture")
    command = ("stylize", *photos[:2], "--each", "-o", tmp_path / "new" / "{style}.ply")
    assert run(*command, *options(styles))[0] == 3
    assert not (tmp_path / "new").exists()


def test_no_usable_style_is_a_bad_input(run: Run, photos: list[Path], tmp_path: Path) -> None:
    broken = [tmp_path / f"broken {n}.png" for n in range(2)]
    for path in broken:
        path.write_bytes(b"no picture")
    code, _, err = run(
        "stylize", *photos, *options(broken), "--each", "-o", tmp_path / "out" / "{style}.ply"
    )
    assert code == 3
    assert str(broken[0]) in err
    assert not list((tmp_path / "out").glob("*"))
