//! One integration binary: each module holds one promise, driven through what a user touches.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

mod cell;
mod floor_plan;
mod identifies_real_robots;
mod identifies_the_papers_robot;
mod inverse_kinematics;
mod jacobian_matches_differences;
mod report_is_self_contained;
