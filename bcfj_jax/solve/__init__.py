"""From a model to a run: solvers, step control, batches, autodiff rules."""
