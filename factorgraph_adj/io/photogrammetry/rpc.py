"""Reader of RPC files of satellite images: RPB, text, XML of DIMAP and of DigitalGlobe.

| file | grammar |
| --- | --- |
| ``*.RPB`` (DigitalGlobe, Maxar) | ``name = value;`` in a group IMAGE, lists in parentheses |
| ``*_RPC.TXT``, ``*_rpc.txt`` (GeoEye, Ikonos, Planet, GDAL) | ``NAME: value unit`` |
| ``RPC_*.XML`` of Pléiades, SPOT 6 and 7 (DIMAP 2) | ``Inverse_Model`` and ``RFM_Validity`` |
| ``*.XML`` of DigitalGlobe | ``<isd>`` with ``<RPB>`` |

Line and sample 0 are the centre of the first pixel in all of them but DIMAP, where it is 1. The
order of the coefficients is that of RPC00B, see `factorgraph_adj.models.rpc_lens`.

Sources: NIMA STDI-0002, appendix E, RPC00B; DigitalGlobe, Image support data (RPB, XML); Airbus,
Pléiades imagery user guide, appendix C; GDAL RFC 22. Tried on the files of ``rpcm`` (Ikonos,
Planet, Pléiades, SPOT 6, WorldView-1 to 3). The RPB and the text of GeoEye-1 in the tests of GDAL
were read by eye only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ...errors import InputError, taking
from ...frames import GeocentricFrame
from ...models.rpc_lens import BIAS, COEFFICIENTS, NORMALISATION, POLYNOMIALS, RpcLens
from ...network.network import Network
from ..format_reader import NetworkReader, Reader, begins_with
from ..source import Field, Problems, TextSource, is_unread
from ..text_files import file_beginning
from ..xml_files import element_at
from ..xml_source import XmlSource
from .block_source import add_pixel_camera

Fields = Mapping[str, Field]
"""Fields of a file by the names of the lens model; lists of 20 by the beginnings of their names."""
_PARTS = {"line": "line", "samp": "samp", "lat": "lat", "long": "long", "height": "height"}
_RPB_NAMES = {
    **{f"{a}Offset": f"{a}_off" for a in _PARTS},
    **{f"{a}Scale": f"{a}_scale" for a in _PARTS},
    **{f"{p[:4]}{p[5:].capitalize()}Coef": p for p in POLYNOMIALS},
}
"""Names of the lens model by those of RPB; those of the XML are the same in capitals."""
_RPB_UNREAD = ("satId", "bandId", "errBias", "errRand", "BEGIN_GROUP", "END_GROUP")
_UNITS = {"line": "pixels", "samp": "pixels", "lat": "degrees", "long": "degrees"}
"""Units of offsets and scales in text files; that of heights is meters."""
_TEXT_UNREAD = ("ERR_BIAS", "ERR_RAND")
_DIMAP_PROFILES = ("PHR_SENSOR", "S6_SENSOR", "S7_SENSOR")
_INVERSE = ("Rational_Function_Model", "Global_RFM", "Inverse_Model")
_VALIDITY = ("Rational_Function_Model", "Global_RFM", "RFM_Validity")
TO_CORNER = 0.5
"""What is added to lines and samples from the centre of the first pixel, where it is 0."""


def read_rpc(
    path: str | Path,
    *,
    free: Sequence[str] = (),
    sigma_shift_px: float | None = None,
) -> Network:
    """Read the rational polynomial coefficients of a satellite image, as a network with one photo.

    The camera and its photo have the name of the file without its suffix. The network is
    geocentric, WGS 84. Image coordinates are pixels from the upper left corner of the first pixel,
    whose centre is (0.5, 0.5): ``line_off`` and ``samp_off`` are those of the file + 0.5, of DIMAP
    − 0.5. y points down in files. No file states the size of the image; that of the camera is
    ``samp_off + samp_scale`` by ``line_off + line_scale`` pixels, as far as the coefficients hold.
    Names of satellite and band, errors as the operator states them, models from
    image to ground and limits of validity are not read.

    Args:
        path: the file.
        free: free parameters of the bias: ``x0`` and ``y0``, a shift, or also ``c``, ``b1``,
            ``b2``, ``b3``, an affine transformation; the others are held, by default all.
        sigma_shift_px: standard deviation of a weighted shift x0, y0, pixels; None: it is held
            unless it is free.

    Raises:
        InputError: the file has problems, each with file and line; ``free`` has another name, or
            ``sigma_shift_px`` is not greater than zero.
    """
    network = Network(Path(path).stem, frame=GeocentricFrame("WGS84"))
    add_rpc_image(network, path, free=free, sigma_shift_px=sigma_shift_px)
    return network


@taking(Network)
def add_rpc_image(
    network: Network,
    path: str | Path,
    *,
    name: str | None = None,
    free: Sequence[str] = (),
    sigma_shift_px: float | None = None,
) -> str:
    """Add a satellite image with the coefficients of a file to a network, see `read_rpc`.

    Args:
        network: a geocentric or topocentric network on WGS 84 or GRS 80.
        path: the file.
        name: name of the camera and its photo; None: that of the file without its suffix.
        free: as for `read_rpc`.
        sigma_shift_px: as for `read_rpc`.

    Returns:
        The name.

    Raises:
        InputError: as `read_rpc`; or the network has a camera or photo of the name.
    """
    name = Path(path).stem if name is None else name
    wrong = [n for n in free if n not in BIAS]
    if wrong:
        valid = f"must be some of {', '.join(BIAS)}"
        raise InputError(f"free {valid}: coefficients are as given, not {', '.join(wrong)}")
    if sigma_shift_px is not None and not sigma_shift_px > 0:
        raise InputError(f"sigma_shift_px must be greater than zero, not {sigma_shift_px!r}")
    problems = Problems()
    values, last = _read(Path(path), problems)
    problems.raise_all()
    sigma = {n: sigma_shift_px for n in ("x0", "y0") if sigma_shift_px and n not in free}
    size = values["samp_off"] + values["samp_scale"], values["line_off"] + values["line_scale"]
    given = {**dict.fromkeys(BIAS, 0.0), "c": 1.0, **values}
    with problems.collect(last):
        add_pixel_camera(network, name, RpcLens(), given, size=size, free=free, sigma=sigma)
        network.add_photo(name, name)
    problems.raise_all()
    return name


def _read(path: Path, problems: Problems) -> tuple[dict[str, float], str]:
    """Return offsets, scales and coefficients, and the last place of a file."""
    beginning = file_beginning(path)
    text = beginning.lstrip(b"\xef\xbb\xbf \t\r\n")
    source: TextSource | XmlSource
    if text.startswith(b"<"):
        source = XmlSource(path, problems=problems)
        fields, first = _from_xml(source)
    else:
        source = TextSource(path, problems)
        fields, first = (_from_rpb if _is_rpb(path) else _from_text)(source), 0.0
    end = source.place(source.last)
    out: dict[str, float] = {}
    for name in NORMALISATION:
        field = fields.get(name) or problems.field(None, name, end)
        value = field.number()
        if value == 0.0 and name.endswith("scale"):
            field.wrong("must not be zero: coordinates are divided by it")
        shift = TO_CORNER - first if name in ("line_off", "samp_off") else 0.0
        out[name] = value + shift
    for name in POLYNOMIALS:
        field = fields.get(name) or problems.field(None, name, end)
        found = field.numbers(COEFFICIENTS)
        if name.endswith("den") and not is_unread(found) and not any(found):
            field.wrong("must not all be zero: they are a denominator")
        out |= {f"{name}_{i}": value for i, value in enumerate(found, 1)}
    for name in ("line", "samp"):
        if out[f"{name}_scale"] < 0.0 or out[f"{name}_off"] + out[f"{name}_scale"] < 0.0:
            problems.wrong(f"{name} offset and scale span no image", end)
    return out, end


def _from_rpb(source: TextSource) -> Fields:
    """Return the fields of an RPB file."""
    words: dict[str, list[str]] = {}
    lines: dict[str, int] = {}
    name = ""
    for line, text in source.filled():
        before, equals, after = text.partition("=")
        if equals:
            name, text = before.strip(), after
            if name in words:
                source.wrong(line, f"{name} stands twice")
            words[name], lines[name] = [], line
        elif text.strip().rstrip(";") == "END":
            name = ""
            continue
        elif not name:
            source.wrong(line, f"{text.strip()[:40]!r} belongs to no name; valid: name = value;")
            continue
        words[name] += re.sub(r"[(),;]", " ", text).split()
    out: dict[str, Field] = {}
    for name, found in words.items():
        field = source.field(lines[name], " ".join(found), name)
        if name in _RPB_NAMES:
            out[_RPB_NAMES[name]] = field
        elif name == "SpecId":
            _check_order(field)
        elif name not in _RPB_UNREAD:
            valid = ", ".join((*_RPB_NAMES, "SpecId", *_RPB_UNREAD))
            source.wrong(lines[name], f"unknown name {name!r}; valid: {valid}")
    return out


def _check_order(field: Field) -> None:
    """Refuse an order of the coefficients that is not that of RPC00B."""
    if str(field.value or "").strip('"') != "RPC00B":
        field.wrong(f"must be RPC00B, whose order of coefficients is read, not {field.value}")


def _from_text(source: TextSource) -> Fields:
    """Return the fields of a text file, ``NAME: value unit``."""
    out: dict[str, Field] = {}
    numbered: dict[str, tuple[int, str]] = {}
    coefficients = {
        f"{p.upper()}_COEFF_{i}": (p, i) for p in POLYNOMIALS for i in range(1, COEFFICIENTS + 1)
    }
    for line, text in source.filled():
        name, colon, rest = (part.strip() for part in text.partition(":"))
        words = rest.split()
        if not colon or not words:
            source.wrong(line, f"{text.strip()[:40]!r} is no 'NAME: value'")
        elif name in numbered:
            source.wrong(line, f"{name} stands twice")
        elif name in coefficients:
            numbered[name] = line, rest
        elif name.lower() in NORMALISATION:
            numbered[name] = line, rest
            unit = _UNITS.get(name.lower().partition("_")[0], "meters")
            if len(words) > 2 or (len(words) == 2 and words[1] != unit):
                source.wrong(line, f"{name} must be a number and perhaps {unit}, not {rest!r}")
            out[name.lower()] = source.field(line, words[0], name)
        elif name not in _TEXT_UNREAD:
            valid = ", ".join((*map(str.upper, NORMALISATION), "LINE_NUM_COEFF_1 …"))
            source.wrong(line, f"unknown name {name!r}; valid: {valid}")
    for polynomial in POLYNOMIALS:
        names = [n for n, (p, _) in coefficients.items() if p == polynomial]
        lacking = [n for n in names if n not in numbered]
        if lacking:
            source.wrong(source.last, f"{', '.join(lacking[:4])} {'…' * (len(lacking) > 4)} absent")
        # Each number has its own line in messages.
        found = [
            source.field(numbered[n][0], numbered[n][1], n).number() for n in names if n in numbered
        ]
        line = numbered[names[0]][0] if names[0] in numbered else source.last
        values = [repr(v) for v in found] + ["0"] * len(lacking)
        if not is_unread(*found):
            out[polynomial] = source.field(line, " ".join(values), polynomial.upper())
    return out


def _from_xml(source: XmlSource) -> tuple[Fields, float]:
    """Return the fields of an XML file, and the number of its first line and sample."""
    root = source.root
    if root.tag == "Dimap_Document":
        profile = source.inside(root, "Metadata_Identification", "METADATA_PROFILE")
        if profile.value not in _DIMAP_PROFILES:
            profile.wrong(f"must be one of {', '.join(_DIMAP_PROFILES)}, not {profile.value!r}")
        order = source.inside(root, "Rational_Function_Model", "Resource_Reference", "RESOURCE_ID")
        _check_order(order)
        out = {n: source.inside(root, *_VALIDITY, n.upper()) for n in NORMALISATION}
        for polynomial in POLYNOMIALS:
            names = [f"{polynomial.upper()}_COEFF_{i}" for i in range(1, COEFFICIENTS + 1)]
            every = [source.inside(root, *_INVERSE, name) for name in names]
            found = [field.number() for field in every]
            if not is_unread(*found):
                text = " ".join(map(repr, found))
                out[polynomial] = source.field(root.line, text, polynomial.upper())
        return out, 1.0
    if root.tag == "isd" and element_at(root, "RPB") is not None:
        _check_order(source.inside(root, "RPB", "SPECID"))
        out = {}
        for name, ours in _RPB_NAMES.items():
            tag = name.upper()
            tags = (f"{tag}List", tag) if ours in POLYNOMIALS else (tag,)
            out[ours] = source.inside(root, "RPB", "IMAGE", *tags)
        return out, 0.0
    what = "no rational polynomials: <Dimap_Document> with a <Rational_Function_Model>, or <isd> "
    raise InputError(f"{source.place(root.line)}: {what}with an <RPB>, are read")


_is_rpb: Callable[[Path], bool] = begins_with(
    rb"\s*+(?:\w+\s*=\s*\"?[^\n]*\n\s*+){0,4}BEGIN_GROUP\s*=\s*IMAGE\b"
)
_is_text: Callable[[Path], bool] = begins_with(rb"\s*+LINE_OFF:[^\n]*\n\s*+SAMP_OFF:")
_is_dimap: Callable[[Path], bool] = begins_with(rb"\s*+(?:<\?[^>]*+>\s*+)?<Dimap_Document\b")
_is_isd: Callable[[Path], bool] = begins_with(rb"\s*+(?:<\?[^>]*+>\s*+)?<isd\b")


def is_rpc(path: Path) -> bool:
    """Tell whether a file has rational polynomial coefficients."""
    dimap = _is_dimap(path) and b"<Rational_Function_Model>" in file_beginning(path)
    return dimap or _is_isd(path) or _is_rpb(path) or _is_text(path)


READER = Reader(
    "rpc",
    (".rpb", ".rpc"),
    "rational polynomial coefficients of a satellite image",
    NetworkReader(read_rpc),
    recognises=is_rpc,
)
