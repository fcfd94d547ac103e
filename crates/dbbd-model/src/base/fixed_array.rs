//! Arrays of fixed length in TOML files. The `toml` crate reads `[1.0, 2.0, 3.0]` where two values are needed, and ignores the
//! third. Each array field of a TOML file has `#[serde(deserialize_with = "fixed_array")]`, which refuses it.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};

/// An array that is read with exactly N values.
pub struct FixedArray<T, const N: usize>(pub [T; N]);

impl<'de, T: Deserialize<'de>, const N: usize> Deserialize<'de> for FixedArray<T, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(N, FixedArrayVisitor(PhantomData))
    }
}

struct FixedArrayVisitor<T, const N: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for FixedArrayVisitor<T, N> {
    type Value = FixedArray<T, N>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "an array of length {N}")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
        let wrong = |found: usize| A::Error::invalid_length(found, &format!("{N} values").as_str());
        // Before a value of a wrong type: with a decimal comma both are wrong.
        if let Some(found) = sequence.size_hint().filter(|found| *found != N) {
            return Err(wrong(found));
        }
        let mut values = Vec::with_capacity(N);
        while let Some(value) = sequence.next_element()? {
            values.push(value);
        }
        let found = values.len();
        values.try_into().map(FixedArray).map_err(|_| wrong(found))
    }
}

/// A field of a TOML file whose arrays are read as [`FixedArray`]: an array of arrays or numbers, which may be missing or in a
/// list.
pub trait HasFixedArrays {
    type Read;

    fn of_read(read: Self::Read) -> Self;
}

macro_rules! plain {
    ($($number:ty),+) => { $(
        impl HasFixedArrays for $number {
            type Read = Self;

            fn of_read(read: Self) -> Self {
                read
            }
        }
    )+ };
}

plain!(f64, u32);

impl<T: HasFixedArrays, const N: usize> HasFixedArrays for [T; N] {
    type Read = FixedArray<T::Read, N>;

    fn of_read(read: Self::Read) -> Self {
        read.0.map(T::of_read)
    }
}

impl<T: HasFixedArrays> HasFixedArrays for Option<T> {
    type Read = Option<T::Read>;

    fn of_read(read: Self::Read) -> Self {
        read.map(T::of_read)
    }
}

impl<T: HasFixedArrays> HasFixedArrays for Vec<T> {
    type Read = Vec<T::Read>;

    fn of_read(read: Self::Read) -> Self {
        read.into_iter().map(T::of_read).collect()
    }
}

/// Reads a field with fixed arrays; the name for `#[serde(deserialize_with = "fixed_array")]`.
///
/// # Errors
/// An array has too few or too many values.
pub fn fixed_array<'de, T, D>(deserializer: D) -> Result<T, D::Error>
where
    T: HasFixedArrays<Read: Deserialize<'de>>,
    D: Deserializer<'de>,
{
    T::Read::deserialize(deserializer).map(T::of_read)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::FileFinding;
    use crate::base::parse::from_toml_text;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    struct ArrayFields {
        #[serde(deserialize_with = "fixed_array")]
        pair: [f64; 2],
        #[serde(default, deserialize_with = "fixed_array")]
        corners: Option<[[f64; 3]; 2]>,
        #[serde(default, deserialize_with = "fixed_array")]
        list: Vec<[u32; 2]>,
    }

    fn lengths(text: &str) -> Option<(usize, usize)> {
        let (_, finding) = from_toml_text::<ArrayFields>(text).unwrap_err();
        if let FileFinding::ArrayLength { found, expected }
        | FileFinding::ArrayLengthByComma { found, expected, .. } = finding
        {
            return Some((found, expected));
        }
        None
    }

    #[test]
    fn arrays_have_as_many_values_as_their_type() {
        let text =
            "pair = [1.0, 2.0]\ncorners = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]\nlist = [[1, 2], [3, 4]]\n";
        let expected = ArrayFields {
            pair: [1.0, 2.0],
            corners: Some([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
            list: vec![[1, 2], [3, 4]],
        };
        assert_eq!(from_toml_text::<ArrayFields>(text).unwrap(), expected);
        let few = from_toml_text::<ArrayFields>("pair = [1.0, 2.0]\n").unwrap();
        assert_eq!((few.corners, few.list), (None, vec![]));
    }

    #[test]
    fn arrays_of_another_length_are_refused() {
        assert_eq!(lengths("pair = [1.0]\n"), Some((1, 2)));
        assert_eq!(lengths("pair = [1.0, 2.0, 3.5]\n"), Some((3, 2)));
        assert_eq!(lengths("pair = [1.0, 2.0]\ncorners = [[1.0, 2.0, 3.0]]\n"), Some((1, 2)));
        assert_eq!(lengths("pair = [1.0, 2.0]\ncorners = [[1.0, 2.0], [4.0, 5.0, 6.0]]\n"), Some((2, 3)));
        assert_eq!(lengths("pair = [1.0, 2.0]\nlist = [[1, 2], [3, 4, 5]]\n"), Some((3, 2)));
    }
}
