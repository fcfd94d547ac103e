//! What the room promises, shown without the program.

mod bad_lines_give_no_lengths;
mod controller_executes_krl;
mod simulated_joint_errors;
