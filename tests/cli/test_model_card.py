"""The bundled model's papers: the card is of what is bundled, the licences' texts come along."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

import pytest

from styl3r_cli.manifest import read_manifest
from styl3r_cli.quality import measured

FOLDER = Path(str(files("styl3r_cli"))) / "models" / "mini"
# What a licence asks to be kept, of each work that the weights descend from.
NOTICES = ("Copyright (c) 2020, princeton-vl", "Copyright (c) 2022 Zhizhong Wang")
CONDITIONS = ("Redistributions in binary form must reproduce", "Permission is hereby granted")


@pytest.fixture(scope="module")
def card() -> str:
    return (FOLDER / "MODEL.md").read_text(encoding="utf-8")


def test_the_card_is_of_the_bundled_version(card: str) -> None:
    [version] = re.findall(r"^# Model card: mini, version (\d+)$", card, re.MULTILINE)
    assert read_manifest(FOLDER).model_version == f"mini_v{version}"
    assert card.count(f"views | mini {version} |") == 3


def test_the_presets_were_measured_on_the_bundled_weights() -> None:
    assert measured()["weights_id"] == read_manifest(FOLDER).weights_id


def test_the_card_leads_to_the_licences_texts(card: str) -> None:
    links = set(re.findall(r"\]\(([^)]+)\)", card))
    assert links == {"LICENCES.md"}
    text = (FOLDER / "LICENCES.md").read_text(encoding="utf-8")
    assert [part for part in NOTICES + CONDITIONS if part not in text] == []
