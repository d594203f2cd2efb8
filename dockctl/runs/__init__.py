"""Run folders: the complete record of a training, written atomically, nothing pickled."""
