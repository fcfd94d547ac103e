//! What the room promises, shown without the program.

mod circular_intervals;
mod circular_quantities;
