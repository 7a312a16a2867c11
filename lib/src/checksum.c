/* A checksum of words in memory that tells which bit has flipped, so that one is mended. Two sums, as
 * Fletcher's (IEEE Transactions on Communications 30(1), 1982), in 64 bits: of the words, and of each word
 * times its distance from the end. A flipped bit changes the first by plus or minus its own value, and the
 * second by that times the distance. */

/* Of so many reals. */
#define WORDS(reals) ((reals) * (sizeof(real) / 4))

static inline uint32_t word_at(const void *data, size_t i) {
	uint32_t word;
	(void)memcpy(&word, (const unsigned char *)data + 4 * i, sizeof word);
	return word;
}

#define CHECKSUM_TAKE(i)                                                                                     \
	words += word_at(at, i);                                                                                 \
	places += words;

/* The sums go on over more words; four at a time, as counting them is a third of the work. */
static inline void checksum_add(koop_checksum *sum, const void *data, size_t count) {
	uint64_t words = sum->words, places = sum->places;
	const unsigned char *at = (const unsigned char *)data;
	for (; count >= 4; count -= 4, at += 16) {
		CHECKSUM_TAKE(0)
		CHECKSUM_TAKE(1)
		CHECKSUM_TAKE(2)
		CHECKSUM_TAKE(3)
	}
	for (; count > 0; count--, at += 4) { CHECKSUM_TAKE(0) }
	sum->words = words;
	sum->places = places;
}

static inline int checksum_same(const koop_checksum *a, const koop_checksum *b) {
	return ((a->words ^ b->words) | (a->places ^ b->places)) == 0;
}

/* Whether no more than a bit of the sums themselves has flipped: one of the words would have changed both. */
static COLD int checksum_has_flipped(const koop_checksum *before, const koop_checksum *now) {
	const uint64_t words = before->words ^ now->words, places = before->places ^ now->places;
	const uint64_t bit = words | places;
	return ((words == 0) | (places == 0)) & ((bit & (bit - 1)) == 0);
}

/* Undoes the one flipped bit that makes the sum `now` where it was `before`; returns 0 where no single one
 * does. `behind` more words were summed after these. */
static COLD int checksum_mend(void *data, size_t words, size_t behind, const koop_checksum *before,
                              const koop_checksum *now) {
	const size_t count = words + behind;
	const int is_set = now->words - before->words <= UINT32_MAX; /* the bit: it was not */
	const koop_checksum *more = is_set ? now : before, *less = is_set ? before : now;
	uint64_t bit = more->words - less->words, distance = more->places - less->places;
	const uint32_t flipped = (uint32_t)bit;
	for (; bit > 1 && ((bit | distance) & 1) == 0; bit /= 2) { distance /= 2; }
	if ((bit != 1) | (flipped == 0) | (distance <= behind) | (distance > count)) { return 0; }
	const size_t i = count - (size_t)distance;
	const uint32_t word = word_at(data, i), fits = ((word & flipped) != 0) == is_set;
	const uint32_t mended = word ^ (fits * flipped);
	(void)memcpy((unsigned char *)data + 4 * i, &mended, sizeof mended);
	return (int)fits;
}
