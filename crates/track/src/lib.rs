//! Find a target, follow it, filter its motion and predict it.
