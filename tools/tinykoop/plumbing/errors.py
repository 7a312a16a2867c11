"""What a user can mend."""


class UserError(Exception):
    """Bad input. Its one line says what, where and how to mend it; the command exits with 2."""
