//! Obstacles.

use serde::{Deserialize, Serialize};

use dbbd_model::base::fixed_array::fixed_array;

/// An obstacle in the robot base.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "FlatObstacle", tag = "shape", rename_all = "lowercase")]
pub enum ObstacleTable {
    /// A box along the axes, by its lowest and its highest corner.
    Box { low_mm: [f64; 3], high_mm: [f64; 3] },
    /// A cylinder by the centres of its ends.
    Cylinder { from_mm: [f64; 3], to_mm: [f64; 3], radius_mm: f64 },
    /// Everything below a height.
    Floor { z_mm: f64 },
}

/// The form that is read, with the keys of all shapes, so that the place of a wrong one is known.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FlatObstacle {
    shape: ObstacleShape,
    #[serde(default, deserialize_with = "fixed_array")]
    low_mm: Option<[f64; 3]>,
    #[serde(default, deserialize_with = "fixed_array")]
    high_mm: Option<[f64; 3]>,
    #[serde(default, deserialize_with = "fixed_array")]
    from_mm: Option<[f64; 3]>,
    #[serde(default, deserialize_with = "fixed_array")]
    to_mm: Option<[f64; 3]>,
    radius_mm: Option<f64>,
    z_mm: Option<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum ObstacleShape {
    Box,
    Cylinder,
    Floor,
}

impl TryFrom<FlatObstacle> for ObstacleTable {
    type Error = &'static str;

    fn try_from(flat: FlatObstacle) -> Result<Self, Self::Error> {
        let FlatObstacle { shape, low_mm, high_mm, from_mm, to_mm, radius_mm, z_mm } = flat;
        match (shape, low_mm, high_mm, from_mm, to_mm, radius_mm, z_mm) {
            (ObstacleShape::Box, Some(low_mm), Some(high_mm), None, None, None, None) => {
                Ok(Self::Box { low_mm, high_mm })
            }
            (ObstacleShape::Cylinder, None, None, Some(from_mm), Some(to_mm), Some(radius_mm), None) => {
                Ok(Self::Cylinder { from_mm, to_mm, radius_mm })
            }
            (ObstacleShape::Floor, None, None, None, None, None, Some(z_mm)) => Ok(Self::Floor { z_mm }),
            (ObstacleShape::Box, ..) => Err("a box has low_mm and high_mm, and no other keys"),
            (ObstacleShape::Cylinder, ..) => {
                Err("a cylinder has from_mm, to_mm and radius_mm, and no other keys")
            }
            (ObstacleShape::Floor, ..) => Err("a floor has z_mm, and no other keys"),
        }
    }
}
