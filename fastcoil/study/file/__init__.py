"""Read a study file (TOML) into a validated study: strict, and with a sentence for every mistake.

Read ``spec`` first, which puts a study together, then ``tables`` (shape of the file), ``loop`` (``[loop]``,
``[sweep]``, ``[cases]``, files included), ``sample`` (``[sample]``) and ``user_code`` (estimators, laws and reductions,
read as text, and run where a study is run).
"""
