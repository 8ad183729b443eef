"""Words of headers of tables in nine languages, by the column of a mapping that they mean.

A header is compared without its unit, accents, case and punctuation: ``Höhenunterschied [m]`` is
``hohenunterschied``. A word may mean several columns: the section of the mapping chooses.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

HEADER_WORDS: dict[str, dict[str, str]] = {
    "name": {
        "en": "name point pt p id no nr number point_name point_id point_number point_no pt_id "
        "pointname pointid pointno ptid station target",
        "de": "punkt punktnummer punktnr punkt_nr pktnr pkt_nr pkt pnr punktname nummer",
        "fr": "point nom matricule numero",
        "es": "punto nombre vertice numero",
        "it": "punto nome vertice numero",
        "pt": "ponto nome vertice numero",
        "nl": "punt puntnummer puntnaam nummer",
        "pl": "punkt nr_punktu numer nazwa",
        "hu": "pont pontszam pontnev psz",
        "ru": "точка имя номер пункт",
    },
    "x": {
        "en": "e east easting x",
        "de": "rechts rechtswert ost ostwert",
        "fr": "est",
        "es": "este",
        "it": "est",
        "pt": "este",
        "nl": "oost",
        "pl": "wschod",
        "hu": "kelet",
        "ru": "восток",
    },
    "y": {
        "en": "n north northing y",
        "de": "hoch hochwert nord nordwert",
        "fr": "nord",
        "es": "norte",
        "it": "nord",
        "pt": "norte",
        "nl": "noord",
        "pl": "polnoc",
        "hu": "eszak",
        "ru": "север",
    },
    "z": {
        "en": "z h height elev elevation level u up alt",
        "de": "hohe hoehe kote",
        "fr": "altitude",
        "es": "cota elevacion altura",
        "it": "quota",
        "pt": "cota altitude",
        "nl": "hoogte",
        "pl": "wysokosc",
        "hu": "magassag",
        "ru": "высота отметка н",
    },
    "fixed": {
        "en": "fixed known control held",
        "de": "fest festpunkt bekannt",
        "fr": "fixe connu",
        "es": "fijo conocido",
        "it": "fisso noto",
        "pt": "fixo conhecido",
        "nl": "vast bekend",
        "pl": "staly znany",
        "hu": "adott fix",
        "ru": "твердыи исходныи",
    },
    "station": {
        "en": "station from at stn occupied setup standpoint rts back backsight",
        "de": "standpunkt von stp stand instrumentenstandpunkt startpunkt anfangspunkt anfang",
        "fr": "station de depuis depart point_de_depart",
        "es": "estacion desde",
        "it": "stazione da",
        "pt": "estacao de",
        "nl": "standplaats van opstelpunt",
        "pl": "stanowisko od",
        "hu": "allaspont",
        "ru": "станция от стояние",
    },
    "target": {
        "en": "target to sighted observed fore foresight",
        "de": "ziel zielpunkt nach zp bis endpunkt ende",
        "fr": "cible vise vers point_vise a arrivee point_d_arrivee",
        "es": "objetivo hacia visado punto_visado",
        "it": "collimato verso punto_collimato",
        "pt": "alvo visado para ponto_visado",
        "nl": "doel naar richtpunt",
        "pl": "cel do",
        "hu": "iranyzott_pont iranyzott",
        "ru": "цель на визирная_цель",
    },
    "face": {
        "en": "face circle",
        "de": "lage kreislage",
        "fr": "cercle",
        "es": "cara",
        "it": "faccia",
        "pt": "face",
        "nl": "kijkerstand",
        "pl": "polozenie",
        "hu": "tavcsoallas",
        "ru": "круг",
    },
    "set": {
        "en": "set round",
        "de": "satz",
        "fr": "serie",
        "es": "serie",
        "it": "serie",
        "pt": "serie",
        "nl": "serie",
        "pl": "seria",
        "hu": "fordulo",
        "ru": "прием",
    },
    "direction": {
        "en": "hz ha har hcr hza hd_angle horizontal_angle horizontal_direction direction dir "
        "horizontalangle",
        "de": "richtung horizontalrichtung horizontalwinkel",
        "fr": "direction angle_horizontal lecture_horizontale",
        "es": "angulo_horizontal lectura_horizontal",
        "it": "angolo_orizzontale direzione",
        "pt": "angulo_horizontal direcao",
        "nl": "richting horizontale_hoek",
        "pl": "kierunek kat_poziomy",
        "hu": "vizszintes_szog iranyertek",
        "ru": "направление горизонтальныи_угол",
    },
    "zenith": {
        "en": "v va vz zenith zenith_angle zen za vertical_angle verticalangle",
        "de": "zenitwinkel zenitdistanz vertikalwinkel zd",
        "fr": "angle_zenithal distance_zenithale",
        "es": "angulo_cenital cenital angulo_vertical",
        "it": "angolo_zenitale zenitale",
        "pt": "angulo_zenital zenital",
        "nl": "zenithoek zenithhoek",
        "pl": "kat_zenitalny zenit kat_pionowy",
        "hu": "zenitszog",
        "ru": "зенитное_расстояние зенитныи_угол",
    },
    "distance": {
        "en": "sd slope_distance slope_dist slopedistance slope s dist distance d sdist",
        "de": "schragstrecke schraegstrecke schragdistanz strecke distanz",
        "fr": "distance_inclinee di",
        "es": "distancia_inclinada distancia_geometrica distancia",
        "it": "distanza_inclinata distanza",
        "pt": "distancia_inclinada",
        "nl": "schuine_afstand afstand",
        "pl": "odleglosc_skosna odleglosc",
        "hu": "ferde_tavolsag tavolsag",
        "ru": "наклонное_расстояние расстояние",
    },
    "horizontal_distance": {
        "en": "hd horizontal_distance hdist horiz_dist horizontal_dist horizontaldistance",
        "de": "horizontalstrecke horizontaldistanz",
        "fr": "distance_horizontale",
        "es": "distancia_horizontal distancia_reducida",
        "it": "distanza_orizzontale",
        "pt": "distancia_horizontal",
        "nl": "horizontale_afstand",
        "pl": "odleglosc_pozioma",
        "hu": "vizszintes_tavolsag",
        "ru": "горизонтальное_проложение",
    },
    "instrument_height": {
        "en": "hi ih instrument_height height_of_instrument instrumentheight",
        "de": "instrumentenhohe instrumentenhoehe instrumenthohe",
        "fr": "hauteur_instrument hauteur_d_instrument",
        "es": "altura_instrumento altura_de_instrumento",
        "it": "altezza_strumento",
        "pt": "altura_instrumento altura_do_instrumento",
        "nl": "instrumenthoogte",
        "pl": "wysokosc_instrumentu",
        "hu": "muszermagassag",
        "ru": "высота_инструмента",
    },
    "target_height": {
        "en": "th ht hr target_height prism_height reflector_height rod_height targetheight",
        "de": "zielhohe zielhoehe reflektorhohe reflektorhoehe prismenhohe prismenhoehe",
        "fr": "hauteur_prisme hauteur_cible",
        "es": "altura_prisma altura_de_prisma",
        "it": "altezza_prisma",
        "pt": "altura_prisma altura_do_prisma",
        "nl": "prismahoogte richthoogte",
        "pl": "wysokosc_celu wysokosc_lustra",
        "hu": "jelmagassag prizmamagassag",
        "ru": "высота_цели высота_визирования",
    },
    "difference": {
        "en": "dh dz delta_h deltah height_difference height_diff difference hdiff rise",
        "de": "hohenunterschied hoehenunterschied hohendifferenz hoehendifferenz",
        "fr": "denivelee denivele difference_d_altitude difference_de_niveau",
        "es": "desnivel",
        "it": "dislivello",
        "pt": "desnivel",
        "nl": "hoogteverschil",
        "pl": "roznica_wysokosci przewyzszenie",
        "hu": "magassagkulonbseg",
        "ru": "превышение",
    },
    "length": {
        "en": "length len l s line_length distance dist",
        "de": "lange laenge weglange strecke",
        "fr": "longueur distance",
        "es": "longitud distancia",
        "it": "lunghezza distanza",
        "pt": "comprimento distancia",
        "nl": "lengte afstand",
        "pl": "dlugosc odleglosc",
        "hu": "hossz tavolsag",
        "ru": "длина расстояние",
    },
    "sigma": {
        "en": "sigma stdev std_dev std standard_deviation se s",
        "de": "standardabweichung mittlerer_fehler",
        "fr": "ecart_type",
        "es": "desviacion_tipica",
        "it": "scarto_quadratico_medio",
        "pt": "desvio_padrao",
        "nl": "standaardafwijking",
        "pl": "odchylenie_standardowe",
        "hu": "kozephiba",
        "ru": "ско",
    },
}
"""Words in a header by column of a mapping and language, as `header_word` writes them."""
LEVEL_BOOK_WORDS = {
    "en": "backsight foresight intermediate intermediate_sight bs fs is",
    "de": "ruckblick rueckblick vorblick zwischenblick",
    "fr": "lecture_arriere lecture_avant visee_arriere visee_avant",
    "es": "lectura_atras lectura_adelante espalda frente",
    "it": "lettura_indietro lettura_avanti battuta_indietro battuta_avanti",
    "pt": "vista_de_re vista_a_re vista_a_vante",
    "nl": "terugblik achterbaak voorbaak",
    "pl": "odczyt_wstecz odczyt_w_przod",
    "hu": "hatra elore",
    "ru": "отсчет_назад отсчет_вперед",
}
"""Words of headers of readings to staves by language, as `header_word` writes them."""
UNIT_WORDS = {
    "m": "m",
    "metres": "m",
    "meters": "m",
    "mm": "mm",
    "km": "km",
    "ft": "ft",
    "feet": "ft",
    "ift": "ft",
    "usft": "us-ft",
    "us ft": "us-ft",
    "us-ft": "us-ft",
    "ftus": "us-ft",
    "gon": "gon",
    "grad": "gon",
    "gr": "gon",
    "g": "gon",
    "deg": "deg",
    "degrees": "deg",
    "°": "deg",
    "dms": "dms",
    "d.mmss": "packed",
    "ddd.mmss": "packed",
    "rad": "rad",
}
"""Units of a mapping by their words in a header."""
_BRACKETS = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]")
_ENDING = re.compile(r"[_ ](m|mm|km|ft|usft|gon|deg|dms|rad)$")
_STROKES = str.maketrans({"ł": "l", "Ł": "L", "ß": "ss", "ø": "o", "Δ": "d", "∆": "d"})


def header_unit(header: str) -> str:
    """Return the unit of a header, in brackets or at its end; '' where it has none.

    >>> header_unit("Hz [gon]"), header_unit("dist_ft"), header_unit("Name")
    ('gon', 'ft', '')
    """
    for found in (_BRACKETS.search(header), _ENDING.search(header.strip().casefold())):
        if found is not None and found[1].casefold() in UNIT_WORDS:
            return UNIT_WORDS[found[1].casefold()]
    return ""


def header_word(header: str) -> str:
    """Return a header as it stands in `HEADER_WORDS`.

    >>> header_word("Höhenunterschied [m]"), header_word("Slope Distance"), header_word("Nr.")
    ('hohenunterschied', 'slope_distance', 'nr')
    """
    text = _BRACKETS.sub("", header).translate(_STROKES).strip().casefold()
    if (ending := _ENDING.search(text)) is not None and ending.start() > 0:
        text = text[: ending.start()]
    plain = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return re.sub(r"[\W_]+", "_", plain).strip("_")


def is_level_book(headers: Iterable[str]) -> bool:
    """Return whether two headers are those of readings to staves, backsights and foresights."""
    words = {word for of in LEVEL_BOOK_WORDS.values() for word in of.split()}
    return sum(header_word(header) in words for header in headers) >= 2


def meanings(header: str) -> list[str]:
    """Return the columns of a mapping that a header may mean, in the order of the table."""
    word = header_word(header)
    return [
        column
        for column, languages in HEADER_WORDS.items()
        if any(word in words.split() for words in languages.values())
    ]
