//! What the room promises, shown without the program.

mod advises_what_to_measure;
