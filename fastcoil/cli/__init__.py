"""The command ``fastcoil``: start with ``main``, which lists the commands.

``study``, ``deliver`` and ``logs`` hold the commands by topic; ``arguments`` and ``terminal`` what they share, and how
a command ends.
"""
