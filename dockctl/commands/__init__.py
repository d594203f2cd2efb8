"""The commands, one a file: parse, call, print. What is heavy is imported when a command runs."""
