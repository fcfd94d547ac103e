//! What the room promises, shown without the program.

mod jacobian_matches_differences;
