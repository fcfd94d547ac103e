//! identifiability
