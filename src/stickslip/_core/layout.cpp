// Memory of blocks; copies of bodies and contacts between the state and memory order; displacement limits of the blocks.
#include <math.h>

#include "blocks.h"

namespace {

double square_of(const double *v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; }

bool is_finite(const double *v) {
  const double zero = (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2]);
  return zero == 0.0;
}

}  // namespace

Blocks *new_blocks(void) { return static_cast<Blocks *>(calloc(1, sizeof(Blocks))); }

void clear_blocks(Blocks *blocks) {
  Blocks &b = *blocks;
  release_all(b.i, b.j, b.row, b.material, b.used, b.wall, b.at, b.vector, b.size, b.mass, b.slip, b.mode, b.place, b.cross,
              b.inner, b.load, b.pair, b.start, b.code);
  b = Blocks{};
}

void free_blocks(Blocks *blocks) {
  clear_blocks(blocks);
  free(blocks);
}

void commit_part(const Blocks &blocks, const Contacts &list, int64_t part, int64_t parts) {
  const int64_t end = blocks.count * (part + 1) / parts * LANES, ahead = 16;
  for (int64_t s = blocks.count * part / parts * LANES; s < end; ++s) {
    const int64_t c = blocks.row.data[s], mode = blocks.mode.data[s];
    const int64_t next = s + ahead < end ? blocks.row.data[s + ahead] : -1;
    if (next >= 0) __builtin_prefetch(list.slip + 3 * next, 1);
    if (c < 0) continue;
    const double *slip = blocks.slip.data + 3 * (s - s % LANES) + s % LANES;
    for (int64_t m = 0; m < 3; ++m) list.slip[3 * c + m] = slip[m * LANES];
    list.mode[c] = static_cast<int8_t>(mode == STUCK_AGAIN ? STICK : mode == LOOSE ? SLIDE : mode);
    list.reached[c] = mode == SLIDE || mode == STUCK_AGAIN;
  }
}

void commit_blocks(const Blocks *blocks, const Contacts *contacts) { commit_part(*blocks, *contacts, 0, 1); }

void morton_keys(const double *x, int64_t n, double size, int64_t *key) {
  for (int64_t a = 0; a < n; ++a) {
    key[a] = 0;
    for (int64_t k = 0; k < 3; ++k) {
      const int64_t cell = static_cast<int64_t>(x[k * n + a] / size);
      for (int64_t bit = 0; bit < 20; ++bit) key[a] |= ((cell >> bit) & 1) << (3 * bit + k);
    }
  }
}

void speeds(const Moving *moving, double *out) {
  double most = 0.0, total = 0.0;
  const int64_t bodies = moving->len_order;
  for (int64_t g = 0; g < bodies; ++g) {
    const double square = square_of(moving->body + BODY * g + VELOCITY);
    most = square > most ? square : most;
    total += square;
  }
  out[0] = sqrt(most);
  out[1] = sqrt(total / (bodies ? bodies : 1));
}

void displacement_limits(const Moving *moving, double base, double span, double least, double most, double *room) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const double limit = base + span * sqrt(square_of(moving->body + BODY * g + VELOCITY));
    room[g] = limit < least ? least : limit;
    room[g] = room[g] > most ? most : room[g];
  }
}

uint8_t limit_displacements(const Moving *moving, const double *origin, double most, double *room) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const double *x = moving->body + BODY * g, *from = origin + 3 * moving->order[g];
    const double moved[3] = {x[0] - from[0], x[1] - from[1], x[2] - from[2]};
    const double left = most - sqrt(square_of(moved));
    if (!(left >= 0.5 * room[g])) return false;
    room[g] = left < room[g] ? left : room[g];
  }
  return true;
}

void gather_bodies(const Moving *moving, const Bodies *bodies, const double *kick, const double *kick_t) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const int64_t a = moving->order[g];
    double *row = moving->body + BODY * g, *ahead = moving->ahead + (moving->len_ahead ? BODY_AHEAD * g : 0);
    for (int64_t k = 0; k < 3; ++k) {
      row[k] = bodies->position[3 * a + k];
      row[VELOCITY + k] = bodies->velocity[3 * a + k];
      row[SPIN + k] = bodies->spin[3 * a + k];
      moving->angle[3 * g + k] = bodies->angle[3 * a + k];
    }
    row[RADIUS] = bodies->radius[a];
    row[KICK] = kick[a];
    row[KICK_T] = kick_t[a];
    if (!moving->len_ahead) continue;
    for (int64_t k = 0; k < 3; ++k) {
      ahead[VELOCITY_AHEAD + k] = row[VELOCITY + k];
      ahead[SPIN_AHEAD + k] = row[SPIN + k];
    }
    ahead[VELOCITY_AHEAD + 3] = ahead[SPIN_AHEAD + 3] = 0.0;
  }
}

void scatter_bodies(const Moving *moving, const Bodies *bodies) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const int64_t a = moving->order[g];
    const double *row = moving->body + BODY * g;
    for (int64_t k = 0; k < 3; ++k) {
      bodies->position[3 * a + k] = row[k];
      bodies->velocity[3 * a + k] = row[VELOCITY + k];
      bodies->spin[3 * a + k] = row[SPIN + k];
      bodies->angle[3 * a + k] = moving->angle[3 * g + k];
    }
  }
}

void pair_vector(const Contacts &contacts, int64_t c, const double *position, const double *vectors, double *out) {
  const double *i = position + 3 * contacts.i[c], *j = position + 3 * contacts.j[c];
  const int16_t *image = contacts.image + 3 * c;
  for (int64_t m = 0; m < 3; ++m)
    out[m] = i[m] - j[m] + (image[0] * vectors[m] + image[1] * vectors[3 + m] + image[2] * vectors[6 + m]);
}

void rolled_length(const double *radius, const double *angle, int64_t i, int64_t j, double *out) {
  for (int64_t m = 0; m < 3; ++m) out[m] = radius[i] * angle[3 * i + m] + radius[j] * angle[3 * j + m];
}

uint8_t store_reference(const Contacts *contacts, const double *position, const double *angle, const double *radius,
                        const double *vectors, int64_t angular, double *pair, double *roll) {
  bool rested = true;
  for (int64_t c = 0; c < contacts->count[0] && (pair || rested); ++c) {
    if (!contacts->mode[c]) continue;
    const int64_t i = contacts->i[c], j = contacts->j[c];
    double r[3], turned[3];
    pair_vector(*contacts, c, position, vectors, r);
    rolled_length(radius, angle, i, j, turned);
    for (int64_t m = 0; m < 3; ++m) {
      rested &= r[m] == contacts->pair[3 * c + m] && turned[m] == contacts->roll[3 * c + m];
      double *anchor = angular ? contacts->rolling + contacts->width_rolling * c + ANCHOR + m : nullptr;
      const double apart = angle[3 * i + m] - angle[3 * j + m];
      rested &= !anchor || *anchor == apart;
      if (!pair) continue;
      pair[3 * c + m] = r[m];
      roll[3 * c + m] = turned[m];
      if (anchor) *anchor = apart;
    }
  }
  return rested;
}

int64_t find_not_finite(const Moving *moving) {
  for (int64_t g = 0; g < moving->len_order; ++g)
    if (!is_finite(moving->body + BODY * g) || !is_finite(moving->angle + 3 * g)) return g;
  return -1;
}

int64_t find_runaway(const Moving *moving, double dt) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const double *row = moving->body + BODY * g, radius = row[RADIUS];
    if (radius > 0.0 && !(square_of(row + VELOCITY) * dt * dt <= radius * radius)) return g;
  }
  return -1;
}
