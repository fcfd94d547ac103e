//! What the room promises, shown without the program.

mod axes_pairs;
mod axes_show_the_poses;
mod capture_survives_damage;
mod continuous_circles;
mod device_time_on_the_hosts_clock;
mod dwells_are_measured;
mod foreign_programs;
mod mounting_faults;
mod sync_joins;
mod sync_pairs;
mod sync_ways_agree;
