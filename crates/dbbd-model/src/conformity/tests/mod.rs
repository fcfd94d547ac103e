//! What the room promises, shown without the program.

mod check_campaigns;
