"""The robots that come with TinyKoop, as the diagnoser sees them: one file each."""
