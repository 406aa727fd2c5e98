"""The command ``fastcoil``: start with ``main``, which lists the commands.

``study``, ``deliver``, ``logs`` and ``design`` hold the commands by topic; ``arguments`` and ``terminal`` what they
share, and how a command ends.
"""
