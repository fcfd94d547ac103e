//! What the room promises, shown without the program.

mod coupled_axes;
mod inverse_kinematics;
mod published_places;
