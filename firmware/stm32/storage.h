/// The storage port: files on a card, one request at a time. stm32_transmit gives out a request,
/// stm32_receive takes its answer, whose `now` is when the operation ended.
///
/// A request is u8 operation and what belongs to it; one file is open at a time. An answer is the u8
/// operation, i32 result, and for STORAGE_READ the data. A result below 0 is an error.
#ifndef SPINDECK_STM32_STORAGE_H
#define SPINDECK_STM32_STORAGE_H

enum {
    STORAGE_CREATE = 1,   ///< then the file's name, without a NUL; to be written
    STORAGE_OPEN = 2,     ///< likewise; to be read
    STORAGE_READ = 3,     ///< then u16, at most so many bytes; the result is how many, 0: the end
    STORAGE_WRITE = 4,    ///< then the bytes; the result is how many, fewer than asked: the card is full
    STORAGE_SEEK = 5,     ///< then u32, from the start; beyond the end: space is allocated
    STORAGE_TRUNCATE = 6, ///< at the position
    STORAGE_SYNC = 7,
    STORAGE_CLOSE = 8, ///< whatever the result, no file is open then
};

enum {
    STORAGE_NO_FILE = -1,
    STORAGE_EXISTS = -2,
    STORAGE_FULL = -3,
    STORAGE_DISK = -4,
    STORAGE_NO_CARD = -5,
};

enum {
    STORAGE_SECTOR_BYTES = 512,
    STORAGE_WRITE_MAX = 4096,   ///< bytes in one request
    STORAGE_READ_MAX = 512,     ///< likewise
    STORAGE_REQUEST_MAX = 4097, ///< 1 + STORAGE_WRITE_MAX: what stm32_transmit wants room for
    STORAGE_HEAD_BYTES = 5,     ///< of an answer
    STORAGE_ANSWER_MAX = 517,   ///< STORAGE_HEAD_BYTES + STORAGE_READ_MAX
};

#endif
