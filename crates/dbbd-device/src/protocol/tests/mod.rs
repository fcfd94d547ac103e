//! What the room promises, shown without the program.

mod decoder_accounts_for_every_byte;
mod definitions_are_checked;
mod first_contact;
