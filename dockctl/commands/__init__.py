"""One module per command: parse options, call one function, print the result. Heavy imports are deferred."""
