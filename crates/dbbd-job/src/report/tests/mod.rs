//! What the room promises, shown without the program.

mod foxglove_layout;
mod mcap_export;
mod report_is_self_contained;
