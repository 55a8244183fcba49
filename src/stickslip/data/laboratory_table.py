"""Columns of laboratory tables, found by usual names and units and converted to metres, seconds and pascals.

The same table of names serves friction records and soil tests. A reader selects the columns that it needs.
"""

import contextlib
import difflib
import re
import unicodedata
import warnings
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import known
from ..core.tables import split_label
from ..core.text import parse_number, shortened
from ..core.units import YEAR
from .laboratory_sheet import Sheet, read_sheet

DAY = 86400.0
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "micron": 1e-6, "nm": 1e-9}
LENGTH |= {"microns": 1e-6, "mic": 1e-6}
TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "min": 60.0, "h": 3600.0}
TIME |= {"seconds": 1.0, "minutes": 60.0, "hours": 3600.0}
TIME |= {"d": DAY, "day": DAY, "days": DAY} | dict.fromkeys(("yr", "year", "years"), YEAR)
STRESS = {"pa": 1.0, "kpa": 1e3, "mpa": 1e6, "gpa": 1e9, "bar": 1e5, "mbar": 1e2, "hpa": 1e2, "psi": 6894.757293168}
STRESS |= {"atm": 101325.0, "n/m2": 1.0, "n/mm2": 1e6, "kn/m2": 1e3, "mn/m2": 1e6, "kgf/cm2": 98066.5}
STRESS |= {"kg/cm2": 98066.5, "psf": 47.88025898034, "ksf": 47880.25898034, "tsf": 95760.51796068}
NUMBER = {"-": 1.0, "1": 1.0, "": 1.0, "na": 1.0}
STRAIN = NUMBER | {"%": 1e-2, "percent": 1e-2, "pct": 1e-2, "per_cent": 1e-2, "m/m": 1.0, "mm/mm": 1.0}
SPEED = {f"{m}/{s}": value / span for m, value in LENGTH.items() for s, span in TIME.items()}
QUANTITIES = {  # units, and names separated by blanks; if a file has columns with several of them, the first is used
    "time": (TIME, "time t sample_time elapsed_time test_time time_elapsed"),
    "load_point": (LENGTH, "load_point load_point_displacement load_point_disp loadpoint lp_displacement lp_disp "
        "lpdisp shear_displacement shear_disp vdcdt displacement disp"),
    "friction": (NUMBER, "friction mu μ friction_coefficient coefficient_of_friction friction_coeff cof"),
    "shear_stress": (STRESS, "shear_stress shr_stress tau τ shear vstress"),
    "normal_stress": (STRESS, "effective_normal_stress eff_normal_stress eff_norm_stress effns normal_stress "
        "norm_stress nor_stress sigma_n σ_n sn hstress"),
    "pore_pressure": (STRESS, "pore_pressure pore_press pore_pres porepressure pore_fluid_pressure "
        "pore_water_pressure fluid_pressure water_pressure pore p_pore pore_p pp p_p pf p_f pfluid p_fluid"),
    "slip": (LENGTH, "slip fault_slip ec_disp"),
    "velocity": (SPEED, "velocity slip_velocity slip_rate"),
    "theta": (TIME, "theta state"),
    "axial_strain": (STRAIN, "axial_strain vertical_strain ε_a ε_1 ε_z epsa e_a e1 strain ε"),
    "log_axial_strain": (STRAIN, "log_axial_strain logarithmic_axial_strain natural_axial_strain true_axial_strain "
        "hencky_axial_strain"),
    "volumetric_strain": (STRAIN, "volumetric_strain volume_strain volumetric ε_v ε_vol εvol epsv e_v"),
    "log_volumetric_strain": (STRAIN, "log_volumetric_strain logarithmic_volumetric_strain natural_volumetric_strain "
        "true_volumetric_strain"),
    "q": (STRESS, "q deviator_stress deviator corrected_deviator_stress q' σ_d stress_difference "
        "principal_stress_difference axial_stress_difference σ1_σ3 σa_σr σ'1_σ'3 s1_s3"),
    "excess_pore_pressure": (STRESS, "excess_pore_pressure excess_pore_water_pressure excess_pwp excess_pressure "
        "pore_pressure_change change_in_pore_pressure delta_u deltau du δu ∆u δ_u u_excess u_ex"),
    "u": (STRESS, "u pwp u_w uw"),
    "p": (STRESS, "p' p_prime p_eff mean_effective_stress effective_camb_p' p'_mean mean_stress p"),
    "axial_stress": (STRESS, "effective_axial_stress effective_vertical_stress effective_major_principal_stress σ'_v "
        "σ'_a σ'_1 axial_stress vertical_stress major_principal_stress σ_v σ_a σ_1 s_1 s'_1"),
    "total_axial_stress": (STRESS, "total_axial_stress total_vertical_stress"),
    "cell_pressure": (STRESS, "cell_pressure confining_pressure confining_stress radial_pressure radial_stress "
        "total_radial_stress minor_principal_stress σ_3 σ_r s_3"),
    "effective_radial_stress": (STRESS, "effective_radial_stress effective_confining_stress "
        "effective_confining_pressure effective_lateral_stress effective_minor_principal_stress σ'_3 σ'_r σ'_h s'_3"),
    "void_ratio": (NUMBER, "void_ratio voids_ratio voidratio e"),
}  # fmt: skip
OTHER_LANGUAGES = {  # names in German, French, Spanish and Italian
    "time": "zeit temps tiempo tempo",
    "load_point": "scherweg verschiebung scherverschiebung weg déplacement deplacement desplazamiento spostamento",
    "friction": "reibungskoeffizient reibung reibwert reibungszahl coefficient_de_frottement frottement "
                "fricción attrito",
    "shear_stress": "schubspannung scherspannung contrainte_de_cisaillement esfuerzo_cortante tensione_di_taglio",
    "normal_stress": "normalspannung contrainte_normale esfuerzo_normal tensione_normale",
    "axial_strain": "axialdehnung axiale_dehnung stauchung axiale_stauchung dehnung déformation_axiale déf_axiale "
                    "deformación_axial deformazione_assiale",
    "volumetric_strain": "volumendehnung volumetrische_dehnung volumenänderung déformation_volumique déf_volumetric "
                         "deformación_volumétrica deformazione_volumetrica",
    "q": "deviatorspannung deviatorische_spannung spannungsdifferenz déviateur contrainte_déviatorique "
         "esfuerzo_desviador tensione_deviatorica",
    "u": "porenwasserdruck porendruck pression_interstitielle presión_de_poros pressione_interstiziale",
    "void_ratio": "porenzahl indice_des_vides índice_de_vacíos relación_de_vacíos indice_dei_vuoti",
    "axial_stress": "axialspannung vertikalspannung contrainte_axiale contrainte_verticale",
    "cell_pressure": "zelldruck pression_de_confinement pression_cellulaire",
}  # fmt: skip
COLUMNS = {
    name: (units, (*names.split(), *OTHER_LANGUAGES.get(name, "").split()))
    for name, (units, names) in QUANTITIES.items()
}
SHORT = {  # abbreviations in headings, and other forms of the same word
    "ax": "axial", "vert": "vertical", "rad": "radial", "vol": "volumetric", "dev": "deviator", "eff": "effective",
    "deviatoric": "deviator", "conf": "confining", "press": "pressure", "pres": "pressure", "disp": "displacement",
    "displ": "displacement",
    "nor": "normal", "norm": "normal", "shr": "shear", "coeff": "coefficient",
}  # fmt: skip
GREEK = ("σ", "sigma|sig"), ("ε", "epsilon|eps"), ("τ", "tau"), ("δ", "delta|∆")  # letters and their names
ABSENT = (-9999.0, -999.0, -99999.0)  # placeholders of some programs for missing numbers
SIMILAR = 0.1  # relative tolerance within which a ratio equals that of two units
SHOWN = 8  # largest number of columns that a message lists
DASHES, PRIMES = "−–—‐-", "’′ʹ`´"


class Wanted(NamedTuple):
    """Columns that a reader looks for."""

    columns: tuple[str, ...]  # names in `COLUMNS`
    example: str  # example of headings, for messages
    rows: str  # kind of the rows in `known.TABLE` for other columns
    numbered: str = ""  # example of column numbers in the syntax of the option, if there is one
    besides: tuple[str, ...] = ()  # columns that are found by heading even if the user names others


class LaboratoryTable(NamedTuple):
    """Sheet of a file, with the columns that are wanted from it."""

    path: Path
    wanted: Wanted
    sheet: Sheet
    headings: list[str]  # (K,) as the user names them
    places: dict[str, tuple[int, float]]  # positions of wanted columns, and factors that convert them to SI units

    def numbers(self) -> dict[str, np.ndarray]:
        """Numbers in the wanted columns in SI units; incomplete rows are left out, and a warning counts them."""
        path, rows = self.path, self.sheet.rows or []
        values = {
            name: self.sheet.values[k] if self.sheet.values is not None
            else np.array([_parse_number(path, row, k, name) for row in rows])
            for name, (k, _) in self.places.items()
        }  # fmt: skip
        missing = np.any([_is_missing(column) for column in values.values()], axis=0)
        if missing.any():
            first = int(missing.argmax())
            location = f"line {rows[first][0]}" if rows else f"sample {first + 1}"
            warnings.warn(
                f"{path}: {missing.sum()} of {len(missing)} rows lack a number (an empty cell, nan or -9999) and are "
                f"skipped; the first is {location}",
                stacklevel=2,
            )
        return {name: column[~missing] * self.places[name][1] for name, column in values.items()}

    def loose_numbers(self, k: int) -> np.ndarray:
        """Numbers in a column, NaN for other entries."""
        if self.sheet.values is not None:
            return self.sheet.values[k]
        column = np.full(len(self.sheet.rows or ()), np.nan)
        for row, (_, fields) in enumerate(self.sheet.rows or ()):
            with contextlib.suppress(ValueError):
                column[row] = parse_number(fields[k])
        return np.where(_is_missing(column), np.nan, column)

    def heading_of(self, name: str) -> str:
        """Heading of a wanted column."""
        return self.headings[self.places[name][0]]

    def has_unit(self, name: str) -> bool:
        """Return True if a wanted column has a unit in its heading or below it."""
        units, aliases = COLUMNS[name]
        return bool(unit_of(self.heading_of(name), aliases, units)[1] or self.sheet.units[self.places[name][0]])

    def groups(self, stresses: str = "") -> list[tuple[str, str, str]]:
        """Heading, group and reason of each column; known columns that are not used count as harmless.

        Parameters
        ----------
        stresses : reason why unknown stresses matter
        """
        used, out = {k for k, _ in self.places.values()}, []
        for k, heading in enumerate(self.sheet.headings):
            word, unit = unit_of(heading, (), {})
            row = known.find_row(self.wanted.rows, word)
            stress = (unit or self.sheet.units[k] or word.rpartition("_")[2]).lower() in STRESS
            named = k in used or _is_wanted(heading, self.wanted, None) or not heading
            group = known.USED if k in used else known.HARMLESS if named else row.group
            why = "" if group != known.UNKNOWN else row.why or stresses * stress
            out.append((heading or f"column {k}", group, why))
        return out

    def list_unknown(self) -> str:
        """Unknown headings, for a message; empty if there are none."""
        strange = [name for name, group, _ in self.groups() if group == known.UNKNOWN]
        return ", ".join(repr(shortened(name)) for name in strange[:SHOWN]) + " …" * (len(strange) > SHOWN)

    def list_columns(self) -> str:
        """Headings of the file, for a message; empty if there are none."""
        seen = [repr(shortened(field)) for field in self.headings if field]
        return ", ".join(seen[:SHOWN]) + (f" and {len(seen) - SHOWN} more" if len(seen) > SHOWN else "")


def open_table(path: Path, wanted: Wanted, named: dict[str, int | str] | None = None) -> LaboratoryTable:
    """Read a table and find the wanted columns.

    Parameters
    ----------
    named : column numbers or headings by standard name; see `friction.read_record`

    Raises
    ------
    ValueError
        If the file cannot be used.
    """
    for name in named or ():
        if not _describe_column(name, wanted)[0]:
            near = difflib.get_close_matches(name, wanted.columns, n=1)
            columns = ", ".join(wanted.columns)
            hint = f"did you mean {near[0]!r}?" if near else f"use {columns}, with a unit such as 'time [s]'"
            raise ValueError(f"the column name {name!r} is unknown: {hint}")
    numbered = wanted.numbered
    sheet = read_sheet(
        path, lambda heading: _is_wanted(heading, wanted, named), named=named is not None, example=wanted.example,
        remedy=f", or give the numbers of the columns ({numbered})" if numbered else "",
    )  # fmt: skip
    headings, bare = (sheet.headings, False) if named is None else _named_headings(path, sheet, named, wanted)
    below = sheet.units if named is None else [None] * len(headings)
    return LaboratoryTable(path, wanted, sheet, headings, _match_columns(path, wanted, headings, below, si=bare))


def plain_word(name: str) -> str:
    """Name of a column in lower case with underscores: "σ₁ − σ₃" becomes "σ1_σ3" and "Ax. strain" "ax_strain".

    Examples
    --------
    >>> plain_word("(σ₁ − σ₃)"), plain_word("Ax. strain"), plain_word("AxialStrain")
    ('σ1_σ3', 'ax_strain', 'axial_strain')
    """
    word = re.sub("(?<=[A-Za-z][a-z])(?=[A-Z][a-z])", "_", re.sub(r"^\(([^()]*)\)", r"\1", name.strip()))
    word = re.sub(r"(?<=[^\W\d_])\.", " ", unicodedata.normalize("NFKC", word).lower())
    word = re.sub(r"\s*([/,])\s*", r"\1", re.sub(f"[{re.escape(PRIMES)}]", "'", word))
    return re.sub("_+", "_", "_".join(re.sub(f"[={re.escape(DASHES)}]", "_", word).split())).strip("_")


@cache
def same_word(word: str) -> str:
    """Canonical form shared by the names of one quantity, from a word of `plain_word`.

    Abbreviations are written out, names of Greek letters become letters, a prime moves to the end, and whole words are
    sorted.

    Examples
    --------
    >>> same_word("sigma'_1") == same_word("σ1'"), same_word("strain_ax") == same_word("axial_strain")
    (True, True)
    """
    for letter, spelt in GREEK:
        word = re.sub(rf"(?<![^\W\d_])({spelt})(?![^\W\d_])", letter, word)
    parts = [SHORT.get(part, part) for part in word.split("_")]
    if all(len(part) > 2 and part.isalpha() for part in parts):
        parts.sort()
    joined = "".join(parts)
    return joined.replace("'", "") + "'" * ("'" in joined)


def unit_of(heading: str, aliases: tuple[str, ...], units: dict[str, float]) -> tuple[str, str | None]:
    """Name and unit of a heading such as `time [s]`, `time/s`, `time, s` or `time_s`; None without a unit.

    The name is one of `aliases` if the heading is a form of it, perhaps with a symbol after it, as in `Void ratio e`.

    Parameters
    ----------
    aliases : names of the wanted column, in lower case, with underscores
    units : units that the column may have
    """
    groups = list(re.finditer(r"[\[(]([^\[\]()]*)[\])]", heading))
    first = bool(groups) and not heading[: groups[0].start()].strip()  # as in "(σ1 − σ3) [kPa]"
    if len(groups) > 1 or first:  # the last brackets have the unit, those before them a symbol or a remark
        last, between = (groups[-1], groups[first:-1]) if len(groups) > first else (None, [])
        end = between[0].start() if between else last.start() if last else len(heading)
        name, unit = heading[:end].strip(), last[1].strip() if last else None
        remark = " ".join(group[1] for group in between)
    else:
        name, unit, remark = *split_label(heading), ""
    word = plain_word(name)
    found = _alias_of(plain_word(f"{name} {remark}"), aliases) or _alias_of(word, aliases)
    if unit is not None or found:
        return found or plain_word(f"{name} {remark}"), unit
    for k in range(len(word) - 1, 0, -1):
        if word[k] not in "_/," or not (found := _alias_of(word[:k], aliases)):
            continue
        rest = word[k + 1 :].removeprefix("in_").replace("_per_", "/").strip("_ ")
        spelt = [rest, rest.replace("_", "/")]
        if known := next((u for u in units if u and u.lower() in spelt), None):
            return found, known
        if word[k] == "/" and not rest.isdigit() and same_word(re.sub("['0]", "", rest)) not in NAMES:
            return found, rest  # "q/p'" is a ratio
    return word, None


def _alias_of(word: str, aliases: tuple[str, ...]) -> str | None:
    """Alias of which a word is a form, perhaps followed by a form of another alias; None if there is none."""
    forms = {same_word(alias): alias for alias in reversed(aliases)}
    if (whole := forms.get(same_word(word))) is not None or same_word(word) in NAMES:
        return whole
    cuts = (k for k, mark in enumerate(word) if mark in "_,")
    return next((forms[same_word(word[:k])] for k in cuts
                 if same_word(word[:k]) in forms and same_word(word[k + 1 :]) in forms), None)  # fmt: skip


NAMES = {same_word(alias) for _, aliases in COLUMNS.values() for alias in aliases}


def unit_of_time(ratio: float, stated: float = 1.0) -> str:
    """Likely unit of times that are too short by the factor `ratio`; empty if it is not the ratio of two units.

    Parameters
    ----------
    stated : stated unit of the times [s]
    """
    near = [unit for unit in ("s", "min", "h", "d", "ms") if abs(TIME[unit] / stated / ratio - 1) < SIMILAR]
    return near[0] if ratio > 0 and near and TIME[near[0]] != stated else ""


def _is_wanted(heading: str, wanted: Wanted, named: dict[str, int | str] | None) -> bool:
    """Return True if a heading names a wanted column."""
    return heading in (named or {}).values() or bool(_describe_column(heading, wanted)[0])


def _named_headings(
    path: Path, sheet: Sheet, columns: dict[str, int | str], wanted: Wanted
) -> tuple[list[str], bool]:  # fmt: skip
    """Headings given by the user, and whether the file itself has none."""
    width, headings, bare = len(sheet.headings), [""] * len(sheet.headings), not any(sheet.headings)
    for name, column in columns.items():
        if isinstance(column, str):
            if column not in sheet.headings:
                seen = ", ".join(repr(shortened(heading)) for heading in sheet.headings[:SHOWN] if heading)
                raise ValueError(
                    f"{path}: the column {column!r} for {name!r} does not exist: the file has {seen or 'no headings'}"
                )
            column = sheet.headings.index(column)
        if not 0 <= column < width:
            raise ValueError(
                f"{path}: column {column} for {name!r} does not exist: the file has columns 0 to {width - 1}"
            )
        headings[column] = name
        aliases, units = _describe_column(name, wanted)
        own, given = unit_of(sheet.headings[column], aliases, units)[1] or sheet.units[column], split_label(name)[1]
        if given is None and own and not bare:
            headings[column] = f"{name} [{own}]"
        elif given and own and units.get(own) != units.get(given):
            warnings.warn(
                f"{path}: --columns gives {name!r}, but the unit in the file is {own!r}: {given!r} is used",
                stacklevel=3,
            )
    for besides in wanted.besides:
        units, aliases = COLUMNS[besides]
        for k, heading in enumerate(sheet.headings):
            word, unit = unit_of(heading, aliases, units)
            if not headings[k] and word in aliases and (unit or sheet.units[k]):
                headings[k] = f"{word} [{unit or sheet.units[k]}]"
    return headings, bare


def _describe_column(name: str, wanted: Wanted) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names and units of the column to which a user's name refers."""
    columns = (COLUMNS[each] for each in wanted.columns)
    return next(
        ((aliases, units) for units, aliases in columns if unit_of(name, aliases, units)[0] in aliases), ((), {})
    )


def _is_missing(column: np.ndarray) -> np.ndarray:
    """Mask of missing samples: not finite, or equal to one of `ABSENT` that is far from all other values."""
    missing = ~np.isfinite(column)
    for mark in ABSENT:
        others = np.unique(column[~missing & (column != mark)])
        if len(others) and np.abs(others - mark).min() > np.diff(others).max(initial=0.0):
            missing |= column == mark
    return missing


def _match_columns(
    path: Path, wanted: Wanted, header: list[str], below: list[str | None], *, si: bool
) -> dict[str, tuple[int, float]]:  # fmt: skip
    """Positions of known columns, and factors that convert them to metres, seconds and pascals."""
    places = {}
    for column in wanted.columns:
        units, aliases = COLUMNS[column]
        labels = [unit_of(field, aliases, units) for field in header]
        alias = next((alias for alias in aliases if any(word == alias for word, _ in labels)), None)
        chosen = [k for k, (word, _) in enumerate(labels) if word == alias]
        if alias is None:
            continue
        if len(chosen) > 1:
            raise ValueError(f"{path} has two columns for {column}: keep only one")
        others = [header[k] for k, (word, _) in enumerate(labels) if word in aliases and k != chosen[0]]
        if others:
            warnings.warn(f"{path}: {column} is {header[chosen[0]]!r}, not {others[0]!r}", stacklevel=2)
        own, row = labels[chosen[0]][1], below[chosen[0]]
        places[column] = (chosen[0], _factor(path, alias, own or row, units, si))
        below_it = _known_unit(row, units)
        if own and below_it and units[below_it] != places[column][1]:
            raise ValueError(f"{path}: {alias} has the unit {own!r} in its heading and {row!r} below it: keep only one")
    return places


def _factor(path: Path, word: str, unit: str | None, units: dict[str, float], si: bool) -> float:
    """Factor that converts a column to metres, seconds and pascals."""
    if unit is None and "" not in units:
        if si:
            return 1.0
        raise ValueError(f"{path}: column {word!r} has no unit: write it as '{word} [{_spelled(next(iter(units)))}]'")
    given = "" if unit is None or ("" in units and unit == ".") else unit
    known = _known_unit(given, units)
    if known is None:
        raise ValueError(
            f"{path}: {word} has the unit {shortened(_plain_unit(given))!r}: use "
            f"{', '.join(list(map(_spelled, filter(None, units)))[:SHOWN])}"
        )
    return units[known]


def _spelled(unit: str) -> str:
    """Unit in its usual spelling; units of pressure are stored in lower case."""
    return re.sub(r"^([hkmg]?)pa$", lambda part: part[1].translate({109: "M", 103: "G"}) + "Pa", unit)


def _plain_unit(unit: str) -> str:
    """Unit without blanks, and with a quotient instead of a negative power: "kN m^-2" becomes "kN/m2"."""
    plain = re.sub(r"[\s·*^]", "", unicodedata.normalize("NFKC", unit))
    return re.sub(rf"(?<=[A-Za-z])(mm|cm|m|s|min|h)[{re.escape(DASHES)}](1|(2))$", r"/\1\3", plain)


def _known_unit(unit: str | None, units: dict[str, float]) -> str | None:
    """Unit among those of a column, ignoring case if there is no exact match; None if there is none."""
    given = _plain_unit(unit or "")
    return next((u for u in units if u == given), None) or next((u for u in units if u.lower() == given.lower()), None)


def _parse_number(path: Path, row: tuple[int, list[str]], k: int, name: str) -> float:
    line, fields = row
    if fields[k].lower() in ("", "nan"):
        return np.nan
    try:
        value = parse_number(fields[k])
    except ValueError:
        raise ValueError(
            f"{path}, line {line}: {name} is {shortened(fields[k])!r}, not a number: correct or remove the line"
        ) from None
    if not np.isfinite(value):
        raise ValueError(
            f"{path}, line {line}: {name} is {shortened(fields[k])}, not a finite number: remove such lines"
        )
    return value
