//! What the room promises, shown without the program.

mod branches_of_users;
mod compensated_joint_errors;
mod compensated_program_is_accurate;
mod compensated_robot_arrives;
mod emitted_programs_run;
mod frame_variants;
mod frames_of_the_controller;
mod krl_reads_back;
mod krl_round_trips;
mod partly_corrected;
mod program_frames;
mod rapid;
mod rapid_and_urscript;
