"""The learner: it sees an environment through Gymnasium's interface and nothing else."""
