"""One reader for every log: a file, DataFrame or Dataset as checked columns, for boundaries, fits, diagnosis, replay.

In the order of reading: ``series`` (every column and unit), ``timestamps`` and ``cells`` (times and numbers as people
write them), ``table`` (a file or Dataset as text), ``columns`` (what headers mean, and which column is which),
``readings`` (bad values), ``pieces`` (gaps and jumps), ``join`` (points logged each at its own times), ``log`` (all).
"""

from fastcoil.logs.columns import Reading as Reading
from fastcoil.logs.log import Log as Log
from fastcoil.logs.log import read_log as read_log
from fastcoil.logs.series import warn_of_reading as warn_of_reading
