"""The learner, which uses an environment only through the Gymnasium interface."""
