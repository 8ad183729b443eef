"""Every path in every file leads into the folder of the file that states it, and no link out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.files import inside
from factorgraph_adj.io.project import load_project
from factorgraph_adj.ledger.command_input import Options
from factorgraph_adj.ledger.journal_entries import start_of
from factorgraph_adj.planning.target_files import read_wishes
from tests.hostile.formats import FORMATS
from tests.networks import photo_files, survey_files

SECRET = "root:x:0:0"
"""What stands in the file outside."""
CRS = '[crs]\nsystem = "EPSG:25832"\ngeoid = "{}"\n'
Case = Callable[[Path, str], object]
"""Writes a file that names a path into a folder, and reads it."""


def _project(text: str, read: Callable[[Path], object] = fga.read_project) -> Case:
    def case(folder: Path, name: str) -> object:
        (folder / "points.csv").write_text("name,x,y,z,fixed\nA,0,0,0,xyz\nB,5,0,0,\n")
        (folder / "project.toml").write_text(text.replace("{}", name.replace("\\", "\\\\")))
        return read(folder)

    return case


def _wishes(folder: Path, name: str) -> object:
    _project("")(folder, "")
    project = load_project(folder, readings=False)
    (folder / "plan.toml").write_text("[files]\ncandidates = '" + name + "'\n")
    return read_wishes(folder / "plan.toml", project)


def _mapping(folder: Path, name: str) -> object:
    form = FORMATS["columns"]
    for file, content in form.files(folder).items():
        (folder / file).write_bytes(content)
    text = (folder / "mapping.toml").read_text()
    name = name.replace("\\", "\\\\")
    (folder / "mapping.toml").write_text(text.replace('"points.csv"', f'"{name}"'))
    return form.reads(folder / form.begin)


def _comp3d(folder: Path, name: str) -> object:
    for file, text in survey_files.COMP3D.items():
        (folder / file).write_text(text)
    with (folder / "net.obs").open("a") as stream:
        stream.write(f"\n@{name}\n")
    return FORMATS["comp3d"].reads(folder / "net.obs")


def _comp(folder: Path, name: str) -> object:
    config = {"root_COR_file": name, "root_OBS_file": name, "center_latitude": 48.8}
    config |= {"refraction": 0.12}
    (folder / "net.comp").write_text("data=" + json.dumps({"config": config}))
    return fga.read_comp3d(folder / "net.comp")


def _opf(folder: Path, name: str) -> object:
    for file, content in photo_files.opf(folder).items():
        (folder / file).write_bytes(content)
    project = json.loads((folder / "block.opf").read_text())
    for item in project["items"]:
        for resource in item["resources"]:
            resource["uri"] = name
    (folder / "block.opf").write_text(json.dumps(project))
    return fga.read(folder / "block.opf")


def _psx(folder: Path, name: str) -> object:
    (folder / "p.psx").write_text(f'<document version="1.2.0" path="{name}"/>')
    return fga.read(folder / "p.psx")


def _dbat(folder: Path, name: str) -> object:
    for file, content in photo_files.dbat().items():
        text = content.decode()
        for other in photo_files.dbat():
            text = text.replace(f">{other}<", f">{name}<")
        (folder / file).write_text(text)
    return fga.read(folder / "script.xml")


CASES: dict[str, Case] = {
    "tables of a project": _project('[files]\npoints = "{}"\n'),
    "a table that is not needed": _project('[files]\npoints = "points.csv"\nphotos = "{}"\n'),
    "geoid of a project": _project(CRS),
    "table of a plan": _wishes,
    "table of a mapping": _mapping,
    "file in a file of Comp3D": _comp3d,
    "files of a project of Comp3D": _comp,
    "resources of OPF": _opf,
    "folder of a project of Metashape": _psx,
    "tables of DBAT": _dbat,
}
NAMES = ("{outside}/secret.csv", "../outside/secret.csv", "..\\outside\\secret.csv", "sub/link.csv",
    "link.csv", "linked/secret.csv", "C:secret.csv")  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_path_that_leads_out_is_refused_and_shows_nothing(case: str, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.csv").write_text(f"name,x,y,z\n{SECRET}\n")
    for number, name in enumerate(NAMES):
        folder = tmp_path / f"project{number}"
        (folder / "sub").mkdir(parents=True)
        for link in (folder / "link.csv", folder / "sub" / "link.csv"):
            link.symlink_to(outside / "secret.csv")
        (folder / "linked").symlink_to(outside, target_is_directory=True)
        with pytest.raises(fga.InputError) as told:
            CASES[case](folder, name.format(outside=outside))
        assert SECRET not in str(told.value), (name, told.value)
        said = ("outside the folder", "symbolic link", "beside this one", "relative to")
        assert any(s in str(told.value) for s in said), (name, str(told.value))


@pytest.mark.parametrize("end", ["csv", "geo", "gsb", "gtx", "tif", "txt", ""])
def test_a_geoid_of_any_kind_lies_in_the_project(end: str, tmp_path: Path) -> None:
    (tmp_path / "project").mkdir()
    secret = tmp_path / f"secret.{end}"
    secret.write_text(SECRET)
    (tmp_path / "project" / f"g.{end}").symlink_to(secret)
    for name in (f"../secret.{end}", str(secret), f"g.{end}"):
        with pytest.raises(fga.InputError, match=r"outside the folder|symbolic link") as told:
            _project(CRS)(tmp_path / "project", name)
        assert SECRET not in str(told.value)


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_beside_that_is_a_link_out_is_not_read(name: str, tmp_path: Path) -> None:
    form = FORMATS[name]
    (tmp_path / "made").mkdir()
    (tmp_path / "outside").mkdir()
    files = form.files(tmp_path / "made")
    for file, content in files.items():
        if file in (form.begin, *form.beside.values()):  # the user has named these
            continue
        here = tmp_path / file.replace(".", "-")
        here.mkdir()
        for other, data in files.items():
            (here / other).write_bytes(data)
        (here / file).unlink()
        (tmp_path / "outside" / file).write_bytes(content)
        (here / file).symlink_to(tmp_path / "outside" / file)
        with pytest.raises(fga.InputError):
            form.reads(here / form.begin)


def test_a_link_that_the_user_names_is_followed(tmp_path: Path) -> None:
    form = FORMATS["gama"]
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "net.gkf").write_bytes(form.files(tmp_path)["net.gkf"])
    (tmp_path / "net.gkf").symlink_to(tmp_path / "outside" / "net.gkf")
    assert fga.read(tmp_path / "net.gkf").points


@pytest.mark.parametrize("name", ["", " ", "a\0b", "/etc/passwd", "a/../b", "C:\\a", "\\\\host\\a"])
def test_what_is_no_path_into_the_folder_is_none(name: str, tmp_path: Path) -> None:
    with pytest.raises(fga.InputError, match=r"^a\.toml:3: path "):
        inside(tmp_path, name, "a.toml:3")
    assert inside(tmp_path, "b\\c.csv", "") == tmp_path / "b" / "c.csv"


def test_journals_and_solutions_open_no_geoid_elsewhere(tmp_path: Path) -> None:
    near, secret = tmp_path / "day" / "n.csv", tmp_path / "secret.csv"
    near.parent.mkdir()
    secret.write_text(f"{SECRET}\n")
    near.write_text("point,N\nA,45.0\n")
    options = asdict(Options("flag", 0.001, 0.01, "given"))

    def opened(geoid: Path, **allowed: Any) -> fga.Network:
        text = CRS.format(geoid) + 'coordinates = "frame"\n'
        line = {"options": options, "files": {"project.toml": text, "points.csv": "name,x,y,z\n"}}
        given = {"geoids": (), "allow_outside": False} | allowed
        return start_of(line, "day.jsonl:1", near.parent, **given)[0]

    for named in (secret, near.parent / ".." / "secret.csv"):
        with pytest.raises(fga.InputError, match="outside the folder") as told:
            opened(named)
        assert SECRET not in str(told.value)
    (near.parent / "link.csv").symlink_to(secret)
    with pytest.raises(fga.InputError, match="outside the folder"):
        opened(near.parent / "link.csv")
    for allowed in ({"allow_outside": True}, {"geoids": [str(near)]}, {}):
        assert opened(near, **allowed).crs is not None
