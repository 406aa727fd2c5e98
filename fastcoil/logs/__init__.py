"""One reader for every log: a file, DataFrame or Dataset as checked columns, for boundaries, fits, diagnosis, replay.

In the order of reading: ``series`` (every column and unit), ``timestamps`` and ``cells`` (times and numbers as people
write them), ``table`` (a file or Dataset as text), ``columns`` (what headers mean, and which column is which),
``readings`` (bad values), ``pieces`` (gaps and jumps), ``own_values`` (repeats of polled points), ``join``
(points logged each at its own times), ``log`` (all).
"""

from fastcoil.logs.columns import ReadingOptions as ReadingOptions
from fastcoil.logs.log import CheckedLog as CheckedLog
from fastcoil.logs.log import read_checked_log as read_checked_log
from fastcoil.logs.series import warn_of_reading_notes as warn_of_reading_notes
