"""Weather made up by a formula, as rows, and as the lines of EPW and TMY3 files."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

CSV_HEADER = ["hour_of_year", "month", "day", "hour", "T_drybulb_C", "T_dewpoint_C", "RH_pct", "p_Pa"]
Row = Mapping[str, Any]


def hours_from(month: int, day: int, n_hours: int, *, leap: bool = False) -> list[dict[str, Any]]:
    """Return rows from hour 1 of a date on, in the order of `CSV_HEADER`."""
    rows = []
    for k in range(n_hours):
        begin = datetime(2024 if leap else 2023, month, day) + timedelta(hours=k)
        hour = begin.hour + 1
        hour_of_year = 24 * (begin.timetuple().tm_yday - 1) + hour
        date = {"hour_of_year": hour_of_year, "month": begin.month, "day": begin.day, "hour": hour}
        T, T_dew = 15.0 + hour / 2 + k // 24, 6.0 + hour / 4
        rows.append(date | {"T": T, "T_dew": T_dew, "RH": 40 + hour, "p": 99500 + 100 * (k % 7)})
    return rows


def epw(rows: Sequence[Row], per_hour: int = 1) -> list[str]:
    """Return the lines of an EPW file: eight of header, rows of 35 cells; the year changes with the month."""
    header = [
        "LOCATION,Testville,XX,ZZZ,Made up,999999,45.00,-73.50,-5.0,36.0",
        "DESIGN CONDITIONS,0",
        "TYPICAL/EXTREME PERIODS,0",
        "GROUND TEMPERATURES,0",
        "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0",
        "COMMENTS 1,made up",
        "COMMENTS 2,",
        f"DATA PERIODS,1,{per_hour},Data,Sunday,1/1,12/31",
    ]
    return header + [
        f"{1980 + int(row['month'])},{row['month']},{row['day']},{row['hour']},{60 // per_hour},?9?9?9?9E0?9,"
        f"{row['T']},{row['T_dew']},{row['RH']},{row['p']}" + ",0" * 25
        for row in rows
    ]


def tmy3(rows: Sequence[Row]) -> list[str]:
    """Return the lines of a TMY3 file: station, header, rows; with some columns that are not read."""
    header = [
        '999999,"TESTVILLE, NORTH",XX,-5.0,45.000,-73.500,36',
        "Date (MM/DD/YYYY),Time (HH:MM),ETR (W/m^2),Dry-bulb (C),Dry-bulb source,Dew-point (C),RHum (%),"
        "Pressure (mbar)",
    ]
    return header + [
        f"{row['month']:0>2}/{row['day']:0>2}/{1982 + int(row['month'])},{row['hour']}:00,0,{row['T']},A,"
        f"{row['T_dew']},{row['RH']},{row['p'] if isinstance(row['p'], str) else row['p'] / 100}"
        for row in rows
    ]
