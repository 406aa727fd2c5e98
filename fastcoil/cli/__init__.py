"""The command ``fastcoil``: start with ``main``, which lists the commands.

``study``, ``plot``, ``deliver``, ``logs``, ``fit`` and ``design`` hold the commands by topic; ``arguments`` and
``terminal`` what they share.  ``interrupts`` and ``streams`` decide how a command ends.
"""
