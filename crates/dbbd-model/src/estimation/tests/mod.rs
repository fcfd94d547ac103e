//! What the room promises, shown without the program.

mod fleet_is_estimated;
mod identifies_to_the_limit;
mod prior_distributes_combinations;
