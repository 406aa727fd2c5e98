"""One reader for every log: a CSV file or a Dataset as checked columns, for boundaries, fits and replay."""

from fastcoil.logs.log import Log as Log
from fastcoil.logs.log import read_log as read_log
from fastcoil.logs.series import warn_of_reading as warn_of_reading
