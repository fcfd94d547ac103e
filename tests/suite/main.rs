//! One integration binary: each module holds one promise, driven through what a user touches.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

mod acquire_reads_the_bar;
mod agrees_with_pinocchio;
mod bad_lines_give_no_lengths;
mod built_in_robots;
mod capture_survives_damage;
mod cell;
mod circle_plan;
mod circular_quantities;
mod compensated_program_is_accurate;
mod compensated_robot_arrives;
mod controller_executes_krl;
mod decoder_accounts_for_every_byte;
mod definitions_are_checked;
mod device_time_on_the_hosts_clock;
mod emitted_programs_run;
mod every_device_round_trips;
mod every_fault_is_accounted_for;
mod floor_plan;
mod identifies_real_robots;
mod identifies_the_papers_robot;
mod identifies_to_the_limit;
mod inverse_kinematics;
mod jacobian_matches_differences;
mod krl_reads_back;
mod obstacle_distances;
mod plan_is_refused_with_a_reason;
mod plans_are_optimal;
mod plans_read_back;
mod refuses_bad_input;
mod report_is_self_contained;
mod runs_the_whole_job;
mod sync_joins;
mod sync_pairs;
mod unplugged_and_back;
