"""Rules of the user's own: estimators and control laws written in Python, and the parameters they bring."""
