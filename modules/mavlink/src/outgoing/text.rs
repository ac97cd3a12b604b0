//! What modules say in words: STATUSTEXT, in pieces of 50 letters.

use uorb_core::Session;
use uorb_msg::LogMessage;

use super::source::{Source, on_update};
use crate::dialect::{MavMessage, STATUSTEXT_DATA};
use crate::followed::Followed;

/// How many bytes of text a message has.
const PIECE_BYTES: usize = 50;

pub(super) fn statustext(session: &Session) -> Box<dyn Source> {
    let mut lead = Followed::<LogMessage>::new(session);
    // What was said before the link began is no news.
    lead.skip();
    let mut id = 0_u16;
    on_update(lead, move |words, send| {
        // 0 stands for a text of one piece.
        id = id.checked_add(1).unwrap_or(1);
        pieces(&words, id).into_iter().for_each(|piece| send(MavMessage::STATUSTEXT(piece)));
    })
}

fn pieces(words: &LogMessage, id: u16) -> Vec<STATUSTEXT_DATA> {
    let end = words.text.iter().position(|byte| *byte == 0).unwrap_or(words.text.len());
    let text = &words.text[..end];
    let is_long = text.len() > PIECE_BYTES;
    let piece = |(chunk_seq, part): (usize, &[u8])| {
        let mut bytes = [0; PIECE_BYTES];
        bytes[..part.len()].copy_from_slice(part);
        STATUSTEXT_DATA {
            severity: words.severity,
            text: bytes.into(),
            id: if is_long { id } else { 0 },
            chunk_seq: chunk_seq as u8,
        }
    };
    let mut pieces: Vec<_> = text.chunks(PIECE_BYTES).enumerate().map(piece).collect();
    // A text ends with a piece that is not full.
    if is_long && text.len().is_multiple_of(PIECE_BYTES) {
        pieces.push(piece((pieces.len(), &[])));
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &str) -> Vec<STATUSTEXT_DATA> {
        let mut words = LogMessage { severity: 4, ..LogMessage::default() };
        words.text[..text.len()].copy_from_slice(text.as_bytes());
        pieces(&words, 7)
    }

    #[test]
    fn a_short_text_is_one_message() {
        let [piece] = &said("takeoff detected")[..] else { panic!("one piece") };
        assert_eq!((piece.id, piece.chunk_seq, piece.severity), (0, 0, 4));
        assert_eq!(piece.text.to_str(), Ok("takeoff detected"));
        assert_eq!(said(&"x".repeat(50)).len(), 1);
    }

    #[test]
    fn a_long_text_comes_in_numbered_pieces() {
        let text = "a".repeat(50) + &"b".repeat(50);
        let pieces = said(&text);
        let numbers: Vec<_> = pieces.iter().map(|piece| (piece.id, piece.chunk_seq)).collect();
        assert_eq!(numbers, [(7, 0), (7, 1), (7, 2)]);
        assert_eq!(pieces[1].text.to_str(), Ok(&text[50..]));
        assert_eq!(pieces[2].text.to_str(), Ok(""));
    }
}
