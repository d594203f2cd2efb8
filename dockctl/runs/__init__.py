"""The run folder: the whole truth of a training run, written atomically and without pickles."""
