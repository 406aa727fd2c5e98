"""Studies: one folder per question, with its study files, scripts, tables and figures.

``__main__`` lists and runs them.  ``common`` opens results and writes tables, ``days`` makes days of every kind; then
read any folder.  ``README.md`` has the answers.
"""
