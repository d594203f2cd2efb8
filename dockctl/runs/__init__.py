"""Run folders: the complete record of a training run, written atomically, nothing pickled."""
