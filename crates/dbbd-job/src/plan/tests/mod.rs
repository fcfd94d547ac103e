//! What the room promises, shown without the program.

mod every_robot_has_a_plan;
mod infeasible_jobs_are_refused;
mod job_keys;
mod obstacle_distances;
mod plans_are_optimal;
mod plans_read_back;
mod years_of_a_robot;
