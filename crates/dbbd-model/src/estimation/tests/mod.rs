//! What the room promises, shown without the program.

pub(super) mod cell_of_poses;
mod finds_what_happened;
mod identifies_to_the_limit;
mod one_estimate_of_all;
mod prior_distributes_combinations;
